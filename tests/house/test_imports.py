"""Who imports whom, by contracts that hold; and what a command loads: a mistyped name no numpy, a check no fit."""

import json
import math
import os
import re
import subprocess
import sys
from copy import deepcopy
from functools import cache
from graphlib import CycleError, TopologicalSorter

import grimp
import pytest
from importlinter.api import read_configuration
from importlinter.application.use_cases import _get_built_in_contract_types
from importlinter.domain.contract import Contract
from scipy import special
from tree import PRODUCT, TOP, module_of, python_files, text_of

from bench import cli
from bench.maths.verdict import coverage_factor
from bench.model.installed import named
from bench.model.systems import own_systems

CONFIGURATION = read_configuration(str(TOP / ".importlinter"))
CONTRACTS = {str(options["id"]): options for options in CONFIGURATION["contracts_options"]}
PLANTED = {
    "floors": ("bench.maths.allan", "bench.plan.compile"),
    "run-in-layers": ("bench.run.links.keeper", "bench.run.watch.clock"),
    "systems": ("bench.systems.north.solve", "bench.systems.gnc.rows"),
    "engine-names-no-system": ("bench.session.partial", "bench.systems.north.analysis"),
    "declarations-are-plain": ("bench.systems.north.declaration", "bench.plan.language.sequence"),
    "estimators": ("bench.systems.north.estimators.phasors", "bench.analysis.figures"),
    "worlds": ("sim_instruments.worlds.north.world", "sim_instruments.worlds.gnc.world"),
    "simulated-bench": ("sim_instruments.worlds.common.world", "sim_instruments.bus.live"),
    "no-instruments-in-bench": ("bench.run.bus.opener", "instruments.hp_3458a"),
    "instruments-know-floor-0-and-frames": ("instruments.hp_3458a", "bench.maths.allan"),
    "real-without-simulated": ("instruments.hp_3458a", "sim_instruments.hp_3458a"),
    "yaml-in-one-loader": ("bench.plan.compile", "yaml"),
    "buses-in-one-opener": ("bench.run.bus.port", "serial"),
    "a-run-does-not-die-of-a-fit": ("bench.run.watch.trend", "scipy"),
    "the-guard-needs-nothing-that-can-fail": ("bench.run.guard.decision", "bench.frame.batch"),
    "clusters-in-one-place": ("bench.commands.study", "distributed"),
    "storage-in-one-place": ("bench.archive.index", "fsspec"),
}
BESIDE = {f"sim_instruments{name}" for name in ("", ".arrays", ".seeds")}  # no models, in the folder of the models
MODELS = {module_of(path) for path in (TOP / "sim_instruments").glob("*.py")}.difference(BESIDE)
SHARED = tuple(f"sim_instruments.{room}" for room in ("arrays", "bus", "faults", "seeds", "worlds.common"))
OF_A_SYSTEM = re.compile(r"sim_instruments\.worlds\.(?!common\b|kinds\b|simulation\b)")


@cache
def graph() -> grimp.ImportGraph:
    """Return every import of the packages; a test plants its violation in a copy."""
    roots = CONFIGURATION["session_options"]["root_packages"]
    return grimp.build_graph(*roots, include_external_packages=True, cache_dir=None)


@cache
def arrows() -> dict[str, set[str]]:
    """Return the modules of the product that each of them imports."""
    names = {module for module in graph().modules if module.startswith(PRODUCT)}
    return {name: graph().find_modules_directly_imported_by(name) & names for name in names}


def is_kept(name: str, planted: tuple[str, str] | None = None, room: str | None = None) -> bool:
    """Return whether a contract, checked alone, holds; ``planted``: one more import, ``room``: one more package."""
    known: dict[str, type[Contract]] = dict(_get_built_in_contract_types())
    options = CONTRACTS[name]
    contract = known[options["type"]](options["name"], CONFIGURATION["session_options"], options)
    changed = deepcopy(graph())
    if planted is not None:
        assert set(planted) <= changed.modules
        changed.add_import(importer=planted[0], imported=planted[1], line_number=1, line_contents="planted")
    if room is not None:
        changed.add_module(room)
    return contract.check(changed, verbose=False).kept


def test_a_planted_violation_breaks_each_contract() -> None:
    """Each contract fails alone when it is violated: import-linter skips what overlaps without a word."""
    assert set(PLANTED) == set(CONTRACTS)
    assert [name for name in CONTRACTS if not is_kept(name)] == []
    assert [name for name, planted in PLANTED.items() if is_kept(name, planted)] == []
    assert not is_kept("floors", room="bench.newroom")


def test_there_is_no_circle() -> None:
    TopologicalSorter(arrows()).prepare()
    with pytest.raises(CycleError):
        TopologicalSorter({"a": {"b"}, "b": {"c.d"}, "c.d": {"a"}, "e": {"a"}}).prepare()


def test_a_simulated_model_knows_what_instruments_share_only() -> None:
    others = {name: {to for to in arrows()[name] - MODELS if to.startswith("sim_instruments")} for name in MODELS}
    assert {(name, to) for name, known in others.items() for to in known if not to.startswith(SHARED)} == set()


def test_only_worlds_of_a_system_know_models() -> None:
    knowing = {name for name, targets in arrows().items() if targets & MODELS} - MODELS
    assert {name for name in knowing if not OF_A_SYSTEM.match(name)} == set()


def test_instruments_know_floor_0_and_frames_only() -> None:
    known = {(name, to) for name, targets in arrows().items() if not name.startswith("bench") for to in targets}
    allowed = ("bench.model", "bench.frame", "instruments", "sim_instruments")
    assert {(name, to) for name, to in known if not to.startswith(allowed)} == set()


def past_a_face(imports: grimp.ImportGraph, module: str, packages: set[str]) -> set[str]:
    """Return imports of modules behind the face of a package the importer is not in, unless the face hands them on."""
    return {
        target
        for target in imports.find_modules_directly_imported_by(module)
        for package in packages
        if target.startswith(f"{package}.") and not f"{module}.".startswith(f"{package}.")
        for one in imports.get_import_details(importer=module, imported=target)
        if not one["line_contents"].startswith(f"from {package} import ")
    }


def test_no_import_past_a_face() -> None:
    rooms = [path for path in python_files(*PRODUCT) if path.name == "__init__.py"]
    packages = {room for path in rooms if f"\nfrom {(room := module_of(path))}." in text_of(path)}
    assert {"bench.record", "bench.frame", "bench.store"} <= packages
    wrong = {module: found for module in arrows() if (found := past_a_face(graph(), module, packages))}
    assert wrong == {}, "import from the package, and let its __init__ hand the name on"


def test_the_search_finds_an_import_past_a_face() -> None:
    planted = grimp.ImportGraph()
    for importer in ("bench.run.session", "bench.record.writer"):
        for line in ("from bench.record.layout import Message", "from bench.record import layout"):
            planted.add_import(
                importer=importer, imported="bench.record.layout", line_number=len(line), line_contents=line
            )
    assert past_a_face(planted, "bench.run.session", {"bench.record"}) == {"bench.record.layout"}
    assert past_a_face(planted, "bench.record.writer", {"bench.record"}) == set()


LOOK = """
import contextlib, io, json, sys
from bench import cli
sys.argv = ["bench", *sys.argv[1:]]
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    try:
        cli.main()
    except SystemExit as ended:
        status = ended.code
print(json.dumps([int(status), sorted(sys.modules)]))
"""
OF_FITS = {"scipy", "matplotlib", "bokeh", "sqlalchemy", "starlette", "uvicorn", "textual", "jinja2", "GTC"}
OF_FILES = {"numpy", "yaml", "pyvisa", "lz4"}
ROOMS = ("bench.analysis", "bench.session", "bench.report", "bench.run", "bench.store")


def loaded_by(*words: str) -> tuple[int, set[str]]:
    """Exit status of a command, and all modules that it loaded."""
    done = subprocess.run([sys.executable, "-c", LOOK, *words], capture_output=True, text=True, check=True)
    status, modules = json.loads(done.stdout)
    return status, set(modules)


@pytest.mark.parametrize("command", ["run", "replay", "fit", "report"])
def test_a_name_that_is_none_costs_nothing(command: str) -> None:
    status, modules = loaded_by(command, "nosuch")
    assert status == 2
    assert modules & (OF_FITS | OF_FILES) == set()
    assert [name for name in modules if name.startswith((*ROOMS, "bench.systems", "bench.plan"))] == []


def test_the_history_loads_no_fit_and_no_drawing() -> None:
    program = "import sys, bench.commands.history.show; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "bench" in done.stdout.split()
    assert not set(done.stdout.split()) & {"scipy", "matplotlib"}


def test_the_normal_coverage_factor_is_known_without_scipy_to_the_last_bit() -> None:
    assert coverage_factor() == float(special.ndtri(0.975)) == 1.959963984540054
    assert coverage_factor(math.inf, 0.99) == float(special.ndtri(0.995))
    assert round(coverage_factor(10.0), 2) == 2.23  # JCGM 100:2008 table G.2


def test_a_check_loads_declarations_and_no_analysis() -> None:
    status, modules = loaded_by("check", "timeline_example")
    assert status == 0
    assert modules & OF_FITS == set()
    assert "asyncio" not in modules
    systems = {name for name in modules if name.startswith("bench.systems.") and name.count(".") > 2}
    assert {name.rpartition(".")[2] for name in systems} <= {"assumptions", "declaration", "sections"}
    assert [name for name in modules if name.startswith(("bench.analysis.", "bench.report.", "bench.store."))] == []


@pytest.mark.parametrize(("before", "after"), [(None, "1"), ("4", "4")])
def test_one_thread_unless_somebody_wants_more(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], before: str | None, after: str
) -> None:
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")
    for name in names:
        monkeypatch.setenv(name, before or "")
        if before is None:
            monkeypatch.delenv(name)
    monkeypatch.setattr(sys, "argv", ["bench", "version"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    assert capsys.readouterr().out
    assert [os.environ[name] for name in names] == [after, after]


def test_every_name_that_a_declaration_holds_as_text_is_there() -> None:
    for declaration in own_systems():
        names = set(re.findall(r"(?<!class )'(bench\.systems\.[\w.]+(?::\w+)?)'", repr(declaration)))
        assert names
        assert all(named(name) for name in names)
