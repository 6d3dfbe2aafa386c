"""What is installed: names that two distributions offer, packages that are foreign or damaged; code of a lab folder."""

import hashlib
import json
import os
import re
import sys
from collections.abc import Callable, Iterator
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from typing import Any

import pytest
from own_lab import ANALYSIS, DRIVER, SIMULATOR, copied
from pydantic import ValidationError
from rehearsal import main_of

from bench.commands.doctor import _installed
from bench.commands.lab.listing import print_list
from bench.commands.schema import schema
from bench.model import installed, systems
from bench.model import lab as code
from bench.model.drivers import driver_class
from bench.model.errors import ExitStatus, InputError, InstallationError
from bench.model.installed import named, simulator_module
from bench.model.systems import analysis_declaration, try_analysis
from bench.plan import language_of_mapping
from bench.plan.language.sequence import language_of_sequence
from bench.run.preflight import Status

CACHES = (
    installed.offers,
    installed.checked_package,
    installed._examined_packages,
    systems._own,
    systems._foreign,
)
BARE = {"sequence": "bare", "station": "none", "steps": [{"settle": "1 s"}]}
SYSTEM = """\
from bench.model.declaration import AnalysisDeclaration, System, UnitSections


class Probes(UnitSections):
    probes: int | None = None


DECLARATION = System("{name}", (AnalysisDeclaration("{analysis}", "x", ("y",), "records"),), unit=Probes)
"""
OWN_DRIVERS = '"""Drivers."""\n\n__bench__ = "stranger"\n'


@pytest.fixture(autouse=True)
def _fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Look below the folder of the test first, and keep nothing that was found there."""
    monkeypatch.syspath_prepend(tmp_path)
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
    names = [offer.name for offer in found]
    assert names == ["af_converter", "gnc", "lock_in", "north", "readings", "time_sync"]
    assert {offer.distribution for offer in found} == {"inertial-bench"}
    assert [system.name for system in systems.systems()] == names
    assert [one.simulators for one in installed.driver_packages()] == ["sim_instruments"]
    assert installed.simulator_module("hp_3458a") == "sim_instruments.hp_3458a"
    assert installed.simulator_module("wire") is None


def test_no_analysis_is_loaded_for_a_declaration() -> None:
    named = {declared.module for declared, _, _ in systems.analyses().values()}
    assert len(named) == 23
    assert all(installed.named(name).analyse for name in sorted(named))


def test_one_name_of_two_distributions_b_pkg_001(tmp_path: Path) -> None:
    """It stops who names it; a system is never named, so the second one is refused and the shipped one goes on."""
    distribution(tmp_path, "stranger", systems="north = elsewhere.north", worlds="fog_north = elsewhere.world")
    package(tmp_path / "elsewhere", "north", init="", declaration=SYSTEM.format(name="north", analysis="other"))
    with pytest.raises(InstallationError, match=r"both offer the world 'fog_north'") as caught:
        installed.offer_of("worlds", "fog_north")
    assert (caught.value.code, int(caught.value.exit_status)) == ("B-PKG-001", 2)
    assert "inertial-bench" in caught.value.message
    assert "stranger" in caught.value.message
    assert installed.offer_of("worlds", "ring_laser") is not None
    assert systems.analysis_declaration("fog_north") is not None
    assert systems.analysis_declaration("other") is None
    assert [(offer.name, error.code) for offer, error in systems.system_refusals()] == [("north", "B-PKG-001")]


def test_one_driver_in_two_packages_b_pkg_001(tmp_path: Path) -> None:
    distribution(tmp_path, "stranger", instruments="stranger = stranger_drivers")
    package(tmp_path, "stranger_drivers", init=OWN_DRIVERS, hp_3458a="", probe_7="")
    found = installed.package_of_driver("probe_7")
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


@pytest.mark.parametrize("text", ['"""Somebody else\'s."""\n', '"""Not ours."""\n\n__bench__ = "other"\n', None])
def test_a_package_without_its_mark_b_pkg_003(tmp_path: Path, text: str | None) -> None:
    distribution(tmp_path, "stranger", instruments="stranger = stranger_drivers")
    package(tmp_path, "stranger_drivers", **({} if text is None else {"init": text}))
    assert driver_class("hp_3458a").__name__ == "Hp3458A"
    assert [package.offer.distribution for package in installed.driver_packages()] == ["inertial-bench"]
    with pytest.raises(InstallationError, match="damaged") as caught:
        driver_class("probe_8")
    assert caught.value.code == "B-PKG-003"
    assert "'probe_8'" in caught.value.message
    assert "stranger" in caught.value.message


def test_a_package_of_another_distribution_is_named_b_pkg_003(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(installed, "packages_distributions", lambda: {"json": ["jsonkit", "inertial-bench"]})
    with pytest.raises(InstallationError, match="is of jsonkit, not of inertial-bench") as caught:
        installed.checked_package("json", "inertial-bench")
    assert caught.value.next_step.startswith("uninstall jsonkit")


def test_a_bench_whose_own_packages_are_another_s_does_nothing_b_pkg_003(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(installed, "_MARK", re.compile("^(never)$"))
    with pytest.raises(InstallationError, match="'instruments' of inertial-bench is damaged"):
        installed.driver_packages()
    assert main_of(monkeypatch, "--help") == ExitStatus.BAD_INPUT
    assert capsys.readouterr().err.startswith("error B-PKG-003: ")


@pytest.mark.parametrize(
    ("text", "says", "line"),
    [
        ("import nowhere_at_all\n", "cannot be loaded: ModuleNotFoundError: No module named 'nowhere_at_all'", 1),
        ("import json\njson.loads('{')\n", "cannot be loaded: JSONDecodeError: ", 2),
        ("import sys\n\nsys.exit(3)\n", "cannot be loaded: SystemExit: 3", 3),
        ("\nx = (\n", "cannot be loaded: SyntaxError: ", 2),
        ("", "holds no DECLARATION", 0),
        ("from bench.model.declaration import System\nDECLARATION = System('x', ())\n", "holds no DECLARATION", 0),
    ],
)
def test_a_broken_declaration_stops_who_names_it_b_pkg_004(tmp_path: Path, text: str, says: str, line: int) -> None:
    name = f"stranger_{abs(hash((text, says)))}"
    distribution(tmp_path, "stranger", systems=f"stranger = {name}")
    package(tmp_path, name, init="", declaration=text)
    shipped = language_of_sequence({"analysis": "fog_north", "uut": {"model": "X", "serial": "1"}})
    assert "fog" in shipped.model_fields["uut"].annotation.__args__[0].model_fields  # type: ignore[union-attr]
    assert f"{name}.declaration" not in sys.modules
    for refused in (language_of_sequence, language_of_mapping):
        with pytest.raises(InstallationError, match=f"the analysis 'curve' is .* of stranger 1.0 {says}") as caught:
            refused({"analysis": "curve"})
        assert caught.value.code == "B-PKG-004"
        place = tmp_path / name / (f"declaration.py:{line}" if line else "declaration.py")
        assert caught.value.where == str(place)
    assert [system.name for system in systems.systems()] == [offer.name for offer in own_offers("systems")]


def test_only_the_declaration_that_is_named_is_read(tmp_path: Path) -> None:
    distribution(tmp_path, "stranger", systems="stranger = stranger_works")
    package(tmp_path, "stranger_works", init="", declaration=SYSTEM.format(name="stranger", analysis="curve"))
    for known in ("fog_north", "none", "readings"):
        language_of_sequence({"analysis": known, "uut": {"model": "X", "fog": {}, "limits": {}}})
        language_of_mapping({"analysis": known, "columns": {"t": {"role": "time"}, "v": {"role": "reading"}}})
    assert "stranger_works.declaration" not in sys.modules
    by_analysis = language_of_sequence({"analysis": "curve"})
    assert "stranger_works.declaration" in sys.modules
    assert language_of_sequence({"analysis": "none", "uut": {"probes": 2}}) is by_analysis
    assert by_analysis.model_validate({**BARE, "uut": {"model": "X", "serial": "1", "probes": 2}}).uut.probes == 2
    with pytest.raises(ValidationError, match="probes"):
        language_of_sequence(None).model_validate({**BARE, "uut": {"model": "X", "serial": "1", "probes": 2}})


def test_drivers_that_cannot_be_loaded_stop_who_names_them_b_pkg_004(tmp_path: Path) -> None:
    distribution(tmp_path, "stranger", instruments="stranger = stranger_broken")
    package(
        tmp_path, "stranger_broken", init=f"{OWN_DRIVERS}raise ValueError('a stranger')\n", probe_9="DRIVER = int\n"
    )
    assert driver_class("hp_3458a").__name__ == "Hp3458A"
    assert installed.simulator_module("hp_3458a") == "sim_instruments.hp_3458a"
    assert "stranger_broken" not in sys.modules
    with pytest.raises(InstallationError, match=r"stranger_broken\.probe_9 of stranger 1\.0 .* a stranger") as caught:
        driver_class("probe_9")
    assert caught.value.where == str(tmp_path / "stranger_broken" / "__init__.py:4")


def test_one_analysis_of_two_foreign_systems_is_nobodys_b_pkg_001(tmp_path: Path) -> None:
    for name in ("stranger_1", "stranger_2"):
        distribution(tmp_path, name, systems=f"{name} = {name}")
        package(tmp_path, name, init="", declaration=SYSTEM.format(name=name, analysis="curve"))
    assert systems.analysis_declaration("fog_north") is not None
    with pytest.raises(InstallationError, match="both offer the analysis 'curve'"):
        language_of_sequence({"analysis": "curve"})


def test_one_analysis_or_section_of_a_foreign_system_and_ours_b_pkg_001(tmp_path: Path) -> None:
    text = SYSTEM.replace("probes", "imu")
    distribution(tmp_path, "stranger", systems="copy = stranger_copy\nmore = stranger_more")
    package(tmp_path, "stranger_copy", init="", declaration=text.format(name="copy", analysis="fog_north"))
    package(tmp_path, "stranger_more", init="", declaration=text.format(name="more", analysis="curve"))
    assert systems.installed_analysis("fog_north").offer.distribution == "inertial-bench"
    (refusal,) = systems.system_refusals()
    assert "both offer the analysis 'fog_north'" in refusal.error.message
    language_of_sequence({"analysis": "imu_six_position", "uut": {"imu": {}}})
    with pytest.raises(InstallationError, match="both declare the section 'imu'"):
        language_of_sequence({"analysis": "curve"})


def own_offers(kind: installed.Kind) -> list[installed.Offer]:
    """What the bench itself offers."""
    return [offer for offer in installed.offers(kind) if offer.distribution == installed.OWN]


def test_listing_commands_tell_what_is_refused_and_go_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    groups = {"systems": "strange_s = stranger_s", "worlds": "strange_w = stranger_w"}
    distribution(tmp_path, "stranger", **groups, instruments="strange_i = stranger_i")
    package(tmp_path, "stranger_s", init="raise ValueError('a')\n")
    package(tmp_path, "stranger_w", init="", world="raise ValueError('b')\n")
    package(tmp_path, "stranger_i", init="")
    print_list(None, None, as_json=True)
    listed = json.loads(capsys.readouterr().out)
    refused = {entry["name"]: entry["title"] for entry in listed if entry["title"].startswith("refused: ")}
    assert {name: title.split()[2] for name, title in refused.items()} == {
        "strange_s": "B-PKG-004:",
        "strange_i": "B-PKG-003:",
    }
    assert f"{tmp_path}/stranger_s/__init__.py:1" in refused["strange_s"]
    assert {"scale_factor", "hp_3458a"} <= {entry["name"] for entry in listed}
    print_list("worlds", None, as_json=True)
    titles = {entry["name"]: entry["title"] for entry in json.loads(capsys.readouterr().out)}
    assert titles["strange_w"].startswith("refused: stranger_w.options of stranger 1.0")
    assert titles["plain_unit.rail_V"].endswith("default 5.01")
    schema(tmp_path / "schemas", vscode=False)
    assert (tmp_path / "schemas" / "sequence.schema.json").exists()
    assert "stranger 1.0" in capsys.readouterr().out
    warned = {finding.name: finding.value for finding in _installed() if finding.status is Status.WARN}
    assert warned == {
        "systems of stranger 1.0": "strange_s: B-PKG-004",
        "worlds of stranger 1.0": "strange_w: B-PKG-004",
        "instruments of stranger 1.0": "strange_i: B-PKG-003",
    }


OTHER = 4242  # a user that is nobody here


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = copied(tmp_path / "lab")
    monkeypatch.chdir(folder)
    return folder.resolve()


def refusal_of(code: str, use: Callable[[], object] = lambda: driver_class("example_t100")) -> InstallationError:
    """Return the error of a use of the lab's driver: one line, exit status 2, nothing executed."""
    sys.modules.pop("lab_folder.instruments.example_t100", None)
    with pytest.raises(InstallationError) as caught:
        use()
    assert (caught.value.code, caught.value.exit_status) == (code, ExitStatus.BAD_INPUT)
    assert "\n" not in str(caught.value)
    assert "lab_folder.instruments.example_t100" not in sys.modules
    return caught.value


def test_driver_simulator_and_analysis_are_found_from_inside(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(lab / "stations")
    driver = driver_class("example_t100")
    assert (driver.__name__, driver.__module__) == ("ExampleT100", "lab_folder.instruments.example_t100")
    assert driver_class("example_t100") is driver
    simulator = simulator_module("example_t100")
    assert simulator is not None
    assert named(f"{simulator}:SIMULATOR").identity.startswith("EXAMPLE,T100")
    declared = analysis_declaration("air_mean")
    assert named(declared.module).METHODS == declared.methods == ("mean",)
    used = code.code_used({"example_t100", "hp_3458a"}, simulated=True, analysis="air_mean")
    assert used == {
        place: hashlib.sha256((lab / place).read_bytes()).hexdigest() for place in (ANALYSIS, DRIVER, SIMULATOR)
    }
    assert not [entry for entry in sys.path if entry.startswith(str(lab))]


def test_outside_there_is_nothing_of_it(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver_class("example_t100")
    monkeypatch.chdir(lab.parent)
    with pytest.raises(InputError, match="there is no driver 'example_t100'"):
        driver_class("example_t100")
    assert analysis_declaration("air_mean") is None
    assert simulator_module("example_t100") is None


def test_a_folder_that_is_gone_is_no_lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    assert driver_class("hp_3458a").__name__ == "Hp3458A"
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("place", [DRIVER, "instruments", ".", ".."])
def test_who_else_can_write_is_told(lab: Path, place: str) -> None:
    path = (lab / place).resolve()
    path.chmod(path.stat().st_mode | 0o002)
    assert str(refusal_of("B-LAB-004")).startswith(f"error B-LAB-004: {path}: can be written to by others. Next: ")
    path.chmod(path.stat().st_mode & ~0o002 | 0o020)
    assert refusal_of("B-LAB-004").where == str(path)
    path.chmod(path.stat().st_mode & ~0o022)
    assert driver_class("example_t100")


def test_the_sticky_bit_protects_above_the_lab_and_not_in_it(lab: Path) -> None:
    lab.chmod(0o1777)
    assert refusal_of("B-LAB-004").where == str(lab)
    lab.chmod(0o755)
    lab.parent.chmod(0o1777)
    assert driver_class("example_t100")
    lab.parent.chmod(0o700)


@pytest.mark.parametrize("place", [DRIVER, "instruments", ".", ".."])
def test_what_belongs_to_somebody_else_is_refused(lab: Path, place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if os.geteuid() == 0:
        os.chown(lab / place, OTHER, -1)
    else:  # who may give nothing away is somebody else
        monkeypatch.setattr(os, "geteuid", lambda: OTHER)
    assert "neither to you nor to root" in refusal_of("B-LAB-004").message


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files away")
@pytest.mark.parametrize(("owner", "is_loaded"), [(OTHER, True), (0, True), (OTHER + 1, False)])
def test_a_user_loads_what_is_of_that_user_or_of_root(
    lab: Path, owner: int, is_loaded: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in (lab, *lab.rglob("*")):
        os.chown(path, owner, -1, follow_symlinks=False)
    monkeypatch.setattr(os, "geteuid", lambda: OTHER)
    if is_loaded:
        assert driver_class("example_t100").__name__ == "ExampleT100"
    else:
        assert refusal_of("B-LAB-004").where == str(lab)


def test_links_are_refused(lab: Path) -> None:
    outside = lab.parent / "outside"
    (lab / "instruments").rename(outside)
    (lab / "instruments").symlink_to(outside)
    assert str(refusal_of("B-LAB-004")).startswith(f"error B-LAB-004: {lab / 'instruments'}: is a link.")
    (lab / "instruments").unlink()
    (lab / "instruments").mkdir(mode=0o755)
    file = lab / DRIVER
    for target in (outside / file.name, lab / "nowhere"):
        file.symlink_to(target)
        error = refusal_of("B-LAB-004")
        assert (error.where, error.message) == (str(file), "is a link")
        file.unlink()


def test_a_pipe_holds_nobody_up(lab: Path) -> None:
    (lab / DRIVER).unlink()
    os.mkfifo(lab / DRIVER)
    assert refusal_of("B-LAB-004").message == "is no file"


@pytest.mark.parametrize(
    ("place", "use"),
    [
        ("instruments/hp_3458a.py", lambda: driver_class("hp_3458a")),
        ("sim_instruments/hp_3458a.py", lambda: simulator_module("hp_3458a")),
        ("analyses/scale_factor.py", lambda: analysis_declaration("scale_factor")),
    ],
)
def test_an_installed_name_is_never_replaced(lab: Path, place: str, use: Callable[[], object]) -> None:
    (lab / place).write_text("raise SystemExit('this was executed')\n")
    error = refusal_of("B-LAB-005", use)
    assert error.where == str(lab / place)
    assert "of what inertial-bench " in error.message


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("x = 1\ny = (\n", 2, "SyntaxError: '(' was never closed"),
        ("from . import beside\n", 1, "ImportError: attempted relative import with no known parent package"),
        ("import json\njson.loads('')\n", 2, "JSONDecodeError: Expecting value"),
        ("x = '\0'\n", None, "source code string cannot contain null bytes"),
    ],
)
def test_what_cannot_be_loaded_is_one_line(lab: Path, text: str, line: int | None, says: str) -> None:
    (lab / "instruments" / "beside.py").write_text("")
    (lab / DRIVER).write_text(text)
    error = refusal_of("B-LAB-006")
    assert error.where == f"{lab / DRIVER}{'' if line is None else f':{line}'}"
    assert f"{DRIVER} cannot be loaded: " in error.message
    assert says in error.message


def test_a_driver_is_named_by_its_file(lab: Path) -> None:
    (lab / DRIVER).write_text("DRIVER = 3\n")
    with pytest.raises(InstallationError, match=r"B-LAB-006: .*names no class as DRIVER"):
        driver_class("example_t100")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"air_mean", __name__', '"another", __name__', "holds no DECLARATION with the name 'air_mean'"),
        ('"readings"', '"logs"', "is made of imported logs"),
        ("DECLARATION =", "DECLARED =", "holds no DECLARATION"),
        ("__name__, METHODS,", '__name__, ("other",),', "has METHODS that are not the methods"),
        ("def analyse", "def analyze", "holds no analyse"),
    ],
)
def test_an_analysis_is_what_it_declares(lab: Path, old: str, new: str, says: str) -> None:
    text = (lab / ANALYSIS).read_text()
    assert old in text
    (lab / ANALYSIS).write_text(text.replace(old, new, 1))
    with pytest.raises(InstallationError, match=f"B-LAB-006: .*{says}"):
        try_analysis("air_mean")


def test_names_that_are_none_are_not_looked_for(lab: Path) -> None:
    for name in ("none", "_private", "Upper", "../outside", "a.b"):
        (lab / "analyses" / name).parent.mkdir(exist_ok=True)
        (lab / "analyses" / f"{name}.py").write_text("raise SystemExit('this was executed')\n")
        assert code.own_code("analyses", name) is None
        assert analysis_declaration(name) is None


def test_what_is_demanded_is_compared_before_it_is_executed(lab: Path) -> None:
    recorded = code.code_used({"example_t100"})
    (lab / DRIVER).write_text("raise SystemExit('this was executed')\n")
    error = refusal_of("B-LAB-007", lambda: code.demand(recorded, "Example laboratory"))
    now = hashlib.sha256((lab / DRIVER).read_bytes()).hexdigest()
    assert error.where == DRIVER
    assert recorded[DRIVER][:12] in error.message
    assert now[:12] in error.message
    (lab / DRIVER).unlink()
    assert "has no such file" in refusal_of("B-LAB-007", lambda: code.demand(recorded, "a lab")).message
    for place in ("../outside.py", "stations/t100_bench.yaml", "/etc/passwd"):
        with pytest.raises(InstallationError, match="B-LAB-007"):
            code.demand({place: "0" * 64}, "a lab")


def test_code_that_a_session_did_not_begin_with_is_refused(lab: Path) -> None:
    used = code.code_used({"example_t100"})
    code.refuse_others(used, used, "a lab")
    assert "not used before" in refusal_of("B-LAB-007", lambda: code.refuse_others({}, used, "a lab")).message


@pytest.mark.parametrize("lab_of_manifest", [None, 3, [], {"name": "x"}, {"files": [1]}])
def test_a_manifest_without_code_of_a_lab_asks_for_none(lab_of_manifest: object) -> None:
    assert code.recorded_code({"lab": lab_of_manifest})[0] == {}
