"""The shipped unit tests: each fault of a module fails exactly its items; killed and gone on with."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from gnc_rig import exchanges, material
from one_estimate import one, value
from rehearsal import SEED, Crashes, Inside, Watched, crashed_at, go_on, nobody, watch_worlds

from bench.analysis import Analysis, GivenValue
from bench.commands.check import checked_plan
from bench.model.clock import VirtualClock
from bench.model.errors import OperatorStop
from bench.plan import Plan, PlannedCommand, Step, compile_sequence
from bench.record import SessionReader
from bench.run.control.asking import _judged
from bench.run.operator import Answer, Question, SimulatedOperator
from bench.run.session import Conducted, conduct
from bench.session.service import read_view
from bench.session.view import analyse_view
from bench.systems.gnc.unit_test.analysis import analyse
from sim_instruments.worlds.common.world import World
from sim_instruments.worlds.gnc.options import FAULTS

SOUND = "S-00"


def summary(folder: Path, unit: str) -> tuple[set[str], float]:
    """Items that failed, and from the first command to the last answer: the paper's "test time" of 8 to 10 s."""
    found = json.loads((folder / "units" / unit / "summary.json").read_text())
    return {item for item, verdict in found["items"].items() if verdict != "pass"}, float(found["elapsed_s"])


@pytest.mark.parametrize("shorted", [False, pytest.param(True, marks=pytest.mark.sweep)])
def test_every_fault_fails_exactly_its_items(inside: Inside, tmp_path: Path, shorted: bool) -> None:
    """One session: a sound unit, then one unit for each fault; ``shorted``: that whose supply is latched off."""
    units = {f"F-{FAULTS[name].code:02}": name for name in FAULTS if (name == "supply_short") == shorted}
    words = ["--set", f"units={','.join([SOUND, *units])}"]
    words += ["--set", "world.faults=" + ",".join(f"{unit}={name}" for unit, name in units.items())]
    done = inside("run", "gnc_unit_test", *words, "--clock", "virtual", "--seed", "5", "--out", str(tmp_path))
    assert done.returncode == 1, done.stderr[-2000:]
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert (folder / "results.json").is_file(), done.stderr[-2000:]
    failed, elapsed_s = summary(folder, SOUND)
    assert (failed, 8.0 <= elapsed_s <= 10.0) == (set(), True)
    found = {name: summary(folder, unit)[0] for unit, name in units.items()}
    assert found == {name: set(FAULTS[name].fails) for name in units.values()}


@pytest.mark.sweep
def test_two_hundred_sound_units_pass(inside: Inside, tmp_path: Path) -> None:
    units = [f"S-{number:03}" for number in range(1, 201)]
    words = ["--set", f"units={','.join(units)}", "--clock", "virtual", "--seed", "77", "--out", str(tmp_path)]
    done = inside("run", "gnc_unit_test", *words)
    assert done.returncode == 0, done.stderr[-2000:]
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    assert [unit for unit in units if summary(folder, unit)[0]] == []
    times_s = [summary(folder, unit)[1] for unit in units]
    print(f"200 units of 200 pass, {min(times_s):.3f} to {max(times_s):.3f} s each")
    assert min(times_s) >= 8.0
    assert max(times_s) <= 10.0


class Gauge(SimulatedOperator):
    """Answers like the simulated operator, but for some questions."""

    def __init__(self, values: dict[str, float]) -> None:
        self._values = values

    def ask(self, question: Question) -> Answer:
        found = [value for text, value in self._values.items() if text in question.text]
        return Answer("somebody", found[0]) if found else super().ask(question)


class Leaver(Gauge):
    """Ends the run at the first question about the second unit."""

    def ask(self, question: Question) -> Answer:
        if "GNC-02" in question.text:
            raise OperatorStop("B-CLI-006", "the operator refused a prompt", where="prompt")
        return super().ask(question)


def watched() -> Watched:
    return Watched(lambda world, step: None, worlds=[None])  # type: ignore[list-item]


def run_units(out: Path, operator: Gauge) -> tuple[Conducted, Analysis]:
    """Two units."""
    plan = compile_sequence("gnc_unit_test", None, {"units": "GNC-01,GNC-02"})
    done = conduct(plan, clock=VirtualClock(), seed=SEED, out=out, operator=operator, listener=watched())
    return done, analyse_view(read_view(done.folder))[1]


def verdicts_of(analysis: Analysis) -> dict[str, str]:
    return {row[0]: row[-1] for row in analysis.tables[0].rows}


def test_a_unit_that_is_too_wide_fails_and_the_batch_goes_on(tmp_path: Path) -> None:
    done, analysis = run_units(tmp_path, Gauge({"GNC-01: width": 0.027}))
    assert done.outcome.error is None
    assert verdicts_of(analysis) == {"GNC-01": "FAIL", "GNC-02": "PASS"}
    assert value(analysis, "width", unit="GNC-01") == 0.027
    beyond = [one(analysis, "width_beyond_limits", unit=unit) for unit in ("GNC-01", "GNC-02")]
    assert beyond[0].value == pytest.approx(0.001)
    assert [entry.verdict for entry in beyond] == ["fail", "pass"]
    (size, *_) = next(table.rows for table in analysis.tables if table.title.startswith("Table 3"))
    assert size[4:] == ["GNC-01", "FAIL"]
    assert one(analysis, "cpu_wrong", unit="GNC-01").verdict == "pass"
    prompts = (fields for _, _, fields in SessionReader(done.folder).events("prompt"))
    (prompt,) = [fields for fields in prompts if "GNC-01: width" in fields["text"]]
    assert (prompt["quantity"], prompt["conditions"]["unit"]) == ("width", "GNC-01")


def given(quantity: str, value: float | None, low: float | None, high: float | None, unit: str = "ohm") -> GivenValue:
    return GivenValue(80.0, 0, quantity, value, unit, low, high, {"unit": "GNC-01"})


@pytest.mark.parametrize(
    ("check", "fails"),
    [
        (given("width", 0.026, 0.020, 0.026, "m"), False),
        (given("width", 0.0260001, 0.020, 0.026, "m"), True),
        (given("width", 0.019, 0.020, 0.026, "m"), True),
        (given("width", 0.027, 0.020, 0.028, "m"), True),  # the specification says 26 mm, whatever the question says
        (given("insulation_resistance", 1e7, 1e7, None), False),
        (given("insulation_resistance", 9.9e6, 1e7, None), True),
        (given("continuity_resistance", 1.5, 1e-3, 1.0), True),
        (given("insulation_resistance", None, 1e7, None), True),
        (given("insulation_resistance", math.nan, 1e7, None), True),
    ],
)
def test_each_check_is_judged_by_its_limits(check: GivenValue, fails: bool) -> None:
    analysis = analyse(replace(material(exchanges()), given=[check]))
    assert analysis.tables[0].rows[0][-1] == ("FAIL" if fails else "PASS")
    wrong = one(analysis, "static_wrong")
    assert (wrong.value, wrong.verdict) == ((1.0, "fail") if fails else (0.0, "pass"))


def test_a_unit_without_the_checks_of_the_others_does_not_pass() -> None:
    both = [*exchanges("GNC-01"), *exchanges("GNC-02", 100)]
    analysis = analyse(replace(material(both), given=[given("width", 0.025, 0.02, 0.026, "m")]))
    assert "unit GNC-02: static check was not tested" in analysis.missing
    assert verdicts_of(analysis)["GNC-02"] == "not tested"
    asked = Question("width", unit="m", low=0.02, high=0.026, quantity="width")
    assert _judged(asked, "27 mm", "somebody").value == 0.027  # whoever answers is not refused a value out of limits


@pytest.mark.parametrize(
    ("text", "value"), [("GNC-01: smallest insulation", 1e5), ("GNC-01: resistance from 5 V", 0.5)]
)
def test_a_unit_with_a_short_is_never_powered(tmp_path: Path, text: str, value: float) -> None:
    done, analysis = run_units(tmp_path, Gauge({text: value}))
    assert done.outcome.error is None
    assert verdicts_of(analysis) == {"GNC-01": "FAIL", "GNC-02": "PASS"}
    items = dict(zip(analysis.tables[1].headers, analysis.tables[1].rows[0], strict=True))
    assert items.pop("static check") == "FAIL"
    assert {verdict for name, verdict in items.items() if name not in ("unit", "identity")} == {"not tested"}
    # off for the first unit, on and off for the second, then the end of every run
    assert switched(done.folder)[:3] == ["OUTP OFF", "OUTP ON", "OUTP OFF"]
    assert switched(done.folder).count("OUTP ON") == 1
    units = {fields["conditions"]["unit"] for _, _, fields in SessionReader(done.folder).events("exchange")}
    assert units == {"GNC-02"}
    (skip,) = [fields for _, _, fields in SessionReader(done.folder).events("skip")]
    plan = compile_sequence("gnc_unit_test", None, {"units": "GNC-01,GNC-02"})
    left_out = plan.steps[skip["first"] : skip["stop"]]
    assert {step.conditions["unit"] for step in left_out} == {"GNC-01"}
    assert plan.steps[skip["stop"]].conditions["unit"] == "GNC-02"


def test_a_run_that_is_gone_on_with_does_not_power_the_unit_either(tmp_path: Path) -> None:
    done, _ = run_units(tmp_path, Leaver({"GNC-01: resistance from 5 V": 0.5}))
    assert done.outcome.error is not None
    assert go_on(done.folder, watched()).outcome.error is None
    analysis = analyse_view(read_view(done.folder))[1]
    assert verdicts_of(analysis) == {"GNC-01": "FAIL", "GNC-02": "PASS"}
    assert switched(done.folder).count("OUTP ON") == 1


def switched(folder: Path) -> list[str]:
    """Commands that switched the supply, from the first static check on."""
    sent = _traffic(folder, "supply")
    begun = max(number for number, text in enumerate(sent) if text.startswith("VOLT "))
    return [text for text in sent[begun:] if text in ("OUTP ON", "OUTP OFF")]


def commands_of(plan: Plan, item: str) -> int:
    """Return how many commands of a plan belong to a test item."""
    return sum(isinstance(step, PlannedCommand) and step.item == item for step in plan.steps)


@pytest.mark.parametrize("item", ["loopback", "cpu", "timer", "memory", "imu", "gps", "ad"])
def test_an_item_is_repeated_or_left_out_by_name(item: str) -> None:
    """As often as asked for, if the time for it is stated."""
    name = "io" if item == "loopback" else item
    once = commands_of(checked_plan("gnc_unit_test", None, ["units=GNC-01"]), name)
    for turns in (2, 3, 10):
        repeats = f"{item}_turns={','.join(map(str, range(1, turns + 1)))}"
        plan = checked_plan("gnc_unit_test", None, ["units=GNC-01", repeats, "functions_time=60 s"])
        assert commands_of(plan, name) == turns * once > 0
    plan = checked_plan("gnc_unit_test", None, ["units=GNC-01", f"{item}_turns="])
    asked = {step.item for step in plan.steps if isinstance(step, PlannedCommand)}
    assert name not in asked
    assert len(asked) > 5


UNITS = ("GNC-01", "GNC-02")
PLACES = {  # kind, name and which of these steps is about to begin when the run is killed
    "static check": ("prompt", "", 19),  # of the second unit
    "supply": ("call", "measure_current", 2),
    "timer": ("unit", "timer", 3),
    "erase": ("unit", "memory", 7),
    "verify": ("unit", "memory", 10),
    "dip switch": ("unit", "ad", 3),
    "io": ("unit", "io", 35),
    "spi": ("unit", "spi", 1),
}


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Crashes:
    """One run of two units, copied at every place, undisturbed to its end."""
    folder = tmp_path_factory.mktemp("units")
    plan = compile_sequence("gnc_unit_test", None, {"units": ",".join(UNITS)})
    return crashed_at(plan, folder, {step_of(plan.steps, *place) for place in PLACES.values()})


def step_of(steps: Any, kind: str, name: str, count: int) -> int:
    found = [step.number for step in steps if (step.kind, step.name if name else "") == (kind, name)]
    return int(found[count - 1])


def results_of(folder: Path) -> dict[str, dict[str, Any]]:
    results, _ = analyse_view(read_view(folder))
    names = [f"{one['quantity']} {json.dumps(one['conditions'], sort_keys=True)}" for one in results["estimates"]]
    assert len(set(names)) == len(names)
    return dict(zip(names, results["estimates"], strict=True))


@pytest.mark.parametrize("place", PLACES)
def test_killed_units_are_tested_to_the_end(
    killed: Crashes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    source = killed.at(step_of(killed.plan.steps, *PLACES[place]))
    folder = Path(shutil.copytree(source, tmp_path / source.name))
    watch_worlds(monkeypatch, watched := nobody())
    run = go_on(folder, watched)
    assert run.outcome.error is None
    assert run.outcome.unsafe == ()
    whole, found = results_of(killed.whole), results_of(folder)
    assert found.keys() == whole.keys()
    assert {name: one.get("verdict") for name, one in found.items()} == {
        name: one.get("verdict") for name, one in whole.items()
    }
    tests = [step.number for step in killed.plan.steps if isinstance(step, PlannedCommand) and step.item]
    noted = [fields["step"] for _, _, fields in SessionReader(folder).events("exchange")]
    assert sorted(set(noted)) == tests
    answered = {fields["step"] for _, _, fields in SessionReader(folder).events("prompt")}
    assert answered == {step.number for step in killed.plan.steps if step.kind == "prompt"}
    assert not watched.worlds[-1].instruments["supply"].on


def test_the_board_is_not_powered_while_a_unit_is_changed(
    killed: Crashes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the way back to the static checks of the second unit its supply stays off."""
    source = killed.at(step_of(killed.plan.steps, *PLACES["static check"]))
    folder = Path(shutil.copytree(source, tmp_path / source.name))
    asked: list[bool] = []

    def look(world: World, step: Step) -> None:
        asked.append(world.instruments["supply"].on)

    watched = Watched(look)
    watch_worlds(monkeypatch, watched)
    go_on(folder, watched)
    first = next(at for at, step in enumerate(watched.steps) if step.name == "output_on")
    assert not any(asked[: first + 1])
    sent = [fields for fields in _traffic(folder, "supply") if fields.startswith("OUTP ON")]
    assert len(sent) == len(UNITS)


def _traffic(folder: Path, role: str) -> list[str]:
    messages = (one for one in SessionReader(folder).messages() if one.topic.endswith(f"/{role}"))
    return [str(one.document()["text"]) for one in messages if one.document()["direction"] == "tx"]


def test_same_seed_same_bytes(tmp_path: Path) -> None:
    runs = [run_units(tmp_path / str(number), Gauge({}))[0] for number in range(2)]
    assert [run.outcome.error for run in runs] == [None, None]
    assert len({(run.folder / "session.0001.mcap").read_bytes() for run in runs}) == 1
