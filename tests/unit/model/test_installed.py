"""What is installed: names that two distributions offer, packages that are foreign or damaged, old metadata."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any

import pytest

from bench.model import installed, systems
from bench.model.drivers import driver_class
from bench.model.errors import InstallationError

CACHES = (
    installed.offers,
    installed.checked_package,
    installed.driver_packages,
    systems.systems,
    systems._offered,
    systems.analyses,
)
OWN_DRIVERS = '"""Drivers."""\n\n__bench__ = "stranger"\n'


@pytest.fixture(autouse=True)
def _fresh() -> Iterator[None]:
    for cached in CACHES:
        cached.cache_clear()
    yield
    for cached in CACHES:
        cached.cache_clear()
    for name in [name for name in sys.modules if name.startswith("stranger")]:
        del sys.modules[name]


def distribution(folder: Path, name: str, **groups: str) -> None:
    """Put a distribution with entry points into a folder; ``groups``: a line of each group."""
    metadata = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [f"[inertial_bench.{group}]\n{line}\n" for group, line in groups.items()]
    (metadata / "entry_points.txt").write_text("\n".join(lines))


def package(folder: Path, name: str, **modules: str) -> None:
    """Put a package into a folder; ``init`` is its ``__init__``."""
    (folder / name).mkdir(parents=True)
    for module, text in modules.items():
        (folder / name / ("__init__.py" if module == "init" else f"{module}.py")).write_text(text)


def test_the_shipped_systems_are_registered_as_a_strangers_are() -> None:
    found = installed.offers("systems")
    assert [*found] == ["af_converter", "gnc", "lock_in", "north", "readings", "time_sync"]
    assert {offer.distribution for offer in found.values()} == {"inertial-bench"}
    assert [system.name for system in systems.systems()] == [*found]
    assert [one.simulators for one in installed.driver_packages()] == ["sim_instruments"]
    assert installed.simulator_module("hp_3458a") == "sim_instruments.hp_3458a"
    assert installed.simulator_module("wire") is None


def test_no_analysis_is_loaded_for_a_declaration() -> None:
    named = {declared.module for declared, _, _ in systems.analyses().values()}
    assert len(named) == 23
    assert all(systems.named(name).analyse for name in sorted(named))


def test_one_name_of_two_distributions_b_pkg_001(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distribution(tmp_path, "stranger", systems="north = elsewhere.north")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InstallationError, match=r"both offer the system 'north'") as caught:
        installed.offers("systems")
    assert (caught.value.code, int(caught.value.exit_status)) == ("B-PKG-001", 2)
    assert "inertial-bench" in caught.value.message
    assert "stranger" in caught.value.message


def test_one_driver_in_two_packages_b_pkg_001(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distribution(tmp_path, "stranger", instruments="stranger = stranger_drivers")
    package(tmp_path, "stranger_drivers", init=OWN_DRIVERS, hp_3458a="", probe_7="")
    monkeypatch.syspath_prepend(tmp_path)
    found = installed.package_of_driver("probe_7")
    assert found is not None
    assert (found.offer.release, found.simulators) == ("stranger 1.0", "")
    assert installed.simulator_module("probe_7") is None
    with pytest.raises(InstallationError, match="both offer the driver 'hp_3458a'"):
        installed.package_of_driver("hp_3458a")


def test_a_folder_of_the_same_name_hides_no_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a lab folder, beside an editable installation: its finder is asked last."""
    distribution(tmp_path / "metadata", "stranger", instruments="stranger = stranger_drivers")
    package(tmp_path / "source", "stranger_drivers", init=OWN_DRIVERS, probe_7="DRIVER = int\n")
    (tmp_path / "lab" / "stranger_drivers").mkdir(parents=True)

    class Editable(MetaPathFinder):
        def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
            return PathFinder.find_spec(name, [str(tmp_path / "source")])

    monkeypatch.setattr(sys, "path", [str(tmp_path / "lab"), str(tmp_path / "metadata"), *sys.path])
    monkeypatch.setattr(sys, "meta_path", [*sys.meta_path, Editable()])
    assert driver_class("probe_7") is int
    assert sys.modules["stranger_drivers"].__file__ == str(tmp_path / "source" / "stranger_drivers" / "__init__.py")


def test_metadata_older_than_the_source_b_pkg_002(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distribution(tmp_path, "inertial-bench")
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    with pytest.raises(InstallationError, match="older than this source") as caught:
        installed.offers("worlds")
    assert (caught.value.code, "make demo" in caught.value.next_step) == ("B-PKG-002", True)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('"""Somebody else\'s."""\n', "damaged"),
        ('"""Not ours."""\n\n__bench__ = "other"\n', "damaged"),
        (None, "damaged"),
    ],
)
def test_a_package_without_its_mark_b_pkg_003(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str | None, says: str
) -> None:
    distribution(tmp_path, "stranger", instruments="stranger = stranger_drivers")
    package(tmp_path, "stranger_drivers", **({} if text is None else {"init": text}))
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InstallationError, match=says) as caught:
        installed.driver_packages()
    assert caught.value.code == "B-PKG-003"
    assert "stranger" in caught.value.message


def test_a_package_of_another_distribution_is_named_b_pkg_003(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installed, "packages_distributions", lambda: {"json": ["jsonkit", "inertial-bench"]})
    with pytest.raises(InstallationError, match="is of jsonkit, not of inertial-bench") as caught:
        installed.checked_package("json", "inertial-bench")
    assert caught.value.next_step.startswith("uninstall jsonkit")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("import nowhere_at_all\n", "cannot be imported"),
        ("", "holds no DECLARATION"),
        ("from bench.model.declaration import System\nDECLARATION = System('x', ())\n", "holds no DECLARATION"),
    ],
)
def test_a_declaration_that_cannot_be_used_b_pkg_004(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, says: str
) -> None:
    name = f"stranger_{abs(hash((text, says)))}"
    distribution(tmp_path, "stranger", systems=f"stranger = {name}")
    package(tmp_path, name, init="", declaration=text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InstallationError, match=says) as caught:
        systems.systems()
    assert caught.value.code == "B-PKG-004"


def test_one_analysis_or_section_of_two_systems_b_pkg_001(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (
        "from bench.model.declaration import AnalysisDeclaration, System, UnitSections\n"
        "class Mine(UnitSections):\n    imu: int | None = None\n"
        "DECLARATION = System('copy', (AnalysisDeclaration('fog_north', 'x', ('y',), 'records'),), unit=Mine)\n"
    )
    distribution(tmp_path, "stranger", systems="copy = stranger_copy")
    package(tmp_path, "stranger_copy", init="", declaration=text)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InstallationError, match="both offer the analysis 'fog_north'"):
        systems.analyses()
    units = [system.unit for system in systems.systems() if system.unit is not None]
    with pytest.raises(InstallationError, match="both declare the section 'imu'"):
        systems.with_sections(installed_form(), units)


def installed_form() -> type:
    """A form of the engine without any field."""
    from bench.model.yamlio import StrictModel

    return StrictModel
