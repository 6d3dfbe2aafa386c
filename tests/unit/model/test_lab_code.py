"""Code of a lab folder: what is loaded, what is refused before it is executed, for a user who is not root too."""

import hashlib
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from own_lab import ANALYSIS, DRIVER, SIMULATOR, copied

from bench.model import lab as code
from bench.model.drivers import driver_class
from bench.model.errors import ExitStatus, InputError, InstallationError
from bench.model.installed import named, simulator_module
from bench.model.systems import analysis_declaration, try_analysis

OTHER = 4242  # a user that is nobody here


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = copied(tmp_path / "lab")
    monkeypatch.chdir(folder)
    return folder.resolve()


def refused(code: str, use: Callable[[], object] = lambda: driver_class("example_t100")) -> InstallationError:
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
    assert str(refused("B-LAB-004")).startswith(f"error B-LAB-004: {path}: can be written to by others. Next: ")
    path.chmod(path.stat().st_mode & ~0o002 | 0o020)
    assert refused("B-LAB-004").where == str(path)
    path.chmod(path.stat().st_mode & ~0o022)
    assert driver_class("example_t100")


def test_the_sticky_bit_protects_above_the_lab_and_not_in_it(lab: Path) -> None:
    lab.chmod(0o1777)
    assert refused("B-LAB-004").where == str(lab)
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
    assert "neither to you nor to root" in refused("B-LAB-004").message


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
        assert refused("B-LAB-004").where == str(lab)


def test_links_are_refused(lab: Path) -> None:
    outside = lab.parent / "outside"
    (lab / "instruments").rename(outside)
    (lab / "instruments").symlink_to(outside)
    assert str(refused("B-LAB-004")).startswith(f"error B-LAB-004: {lab / 'instruments'}: is a link.")
    (lab / "instruments").unlink()
    (lab / "instruments").mkdir(mode=0o755)
    file = lab / DRIVER
    for target in (outside / file.name, lab / "nowhere"):
        file.symlink_to(target)
        error = refused("B-LAB-004")
        assert (error.where, error.message) == (str(file), "is a link")
        file.unlink()


def test_a_pipe_holds_nobody_up(lab: Path) -> None:
    (lab / DRIVER).unlink()
    os.mkfifo(lab / DRIVER)
    assert refused("B-LAB-004").message == "is no file"


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
    error = refused("B-LAB-005", use)
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
    error = refused("B-LAB-006")
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
    error = refused("B-LAB-007", lambda: code.demand(recorded, "Example laboratory"))
    now = hashlib.sha256((lab / DRIVER).read_bytes()).hexdigest()
    assert error.where == DRIVER
    assert recorded[DRIVER][:12] in error.message
    assert now[:12] in error.message
    (lab / DRIVER).unlink()
    assert "has no such file" in refused("B-LAB-007", lambda: code.demand(recorded, "a lab")).message
    for place in ("../outside.py", "stations/t100_bench.yaml", "/etc/passwd"):
        with pytest.raises(InstallationError, match="B-LAB-007"):
            code.demand({place: "0" * 64}, "a lab")


def test_code_that_a_session_did_not_begin_with_is_refused(lab: Path) -> None:
    used = code.code_used({"example_t100"})
    code.refuse_others(used, used, "a lab")
    assert "not used before" in refused("B-LAB-007", lambda: code.refuse_others({}, used, "a lab")).message


@pytest.mark.parametrize("lab_of_manifest", [None, 3, [], {"name": "x"}, {"files": [1]}])
def test_a_manifest_without_code_of_a_lab_asks_for_none(lab_of_manifest: object) -> None:
    assert code.recorded_code({"lab": lab_of_manifest})[0] == {}
