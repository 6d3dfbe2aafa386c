"""A campaign whose second soak the unit's lag ends: results, the course of the run, a kill inside of a soak, replay.

The lags of chamber and unit are a tenth of the usual ones.
"""

import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
from rehearsal import CLOSING, ONE_CHANNEL, SHORT_SEQUENCE, compiled, go_on, rehearsed, shortened
from units_campaign import events_of

from bench.analysis import results_json
from bench.commands.session import replay
from bench.model.errors import ExitStatus
from bench.plan import Plan, Step, check_plan
from bench.record import SessionReader
from bench.session.service import read_view
from bench.session.view import analyse_view, report_of
from bench.web.recorded.past import Past
from sim_instruments.worlds.common import thermal
from sim_instruments.worlds.common.world import World

SLOT_s, POINTS_s, RESIDUAL_degC, LEAST_s = 1800.0, 15 * 30.0, 0.1, 500.0
KILLED_s = 700.0  # after the second soak has begun: its ramp is over, it is not


def plan_in(folder: Path) -> Plan:
    """Return scale_factor_short cut down to one channel at two temperatures, with soaks that the lag may end."""
    done = f"late: hold\n          done: {{residual: {RESIDUAL_degC} degC, least: {LEAST_s:g} s}}"
    changes = (
        ("sequence: scale_factor_short", "sequence: by_lag"),
        ("duration: 10350 s\nrecords: 105", f"duration: {2.0 * (SLOT_s + POINTS_s):g} s\nrecords: 30"),
        ("slot: 3600 s", f"slot: {SLOT_s:g} s"),
        ("ramp: 0.5 degC/min\n  slot", "ramp: 1 degC/min\n  slot"),
        ("in: [23 degC, 25 degC]", "in: [26 degC, 31 degC]"),
        ("late: hold", done),
        *ONE_CHANNEL,
    )
    plan = compiled(shortened(SHORT_SEQUENCE, folder, "by_lag", *changes, cut=CLOSING))
    assert check_plan(plan) == []
    return plan


@dataclass
class Ran:
    plan: Plan
    whole: Path
    killed: Path  # as it was in the middle of the second soak
    world: World


def hurry(patch: pytest.MonkeyPatch) -> None:
    """Let chamber and unit of every bench lag a tenth of the usual."""
    for name in ("AIR_LAG_S", "UNIT_LAG_S"):
        patch.setattr(thermal, name, getattr(thermal, name) / 10.0)


def ran_in(folder: Path) -> Ran:
    """Run it once, copied in the middle of the second soak."""
    plan = plan_in(folder)
    second = [step.number for step in plan.phase("campaign") if step.kind == "soak"][1]

    def watch(world: World, step: Step) -> None:
        if step.number == second:
            timer = world.clock.every(KILLED_s, lambda: copy() or timer.cancel())  # type: ignore[func-returns-value]

    def copy() -> None:
        (session,) = (folder / "out").iterdir()
        shutil.copytree(session, folder / "killed" / session.name)

    with pytest.MonkeyPatch.context() as patch:
        hurry(patch)
        done = rehearsed(folder / "out", plan, act=watch)
    assert done.run.outcome.error is None
    return Ran(plan, done.run.folder, folder / "killed" / done.run.folder.name, done.world)


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Ran:
    return ran_in(tmp_path_factory.mktemp("by_lag"))


def test_the_second_soak_is_as_near_as_stated_and_what_follows_is_earlier(ran: Ran) -> None:
    first, second = events_of(ran.whole, "thermal_lag")
    assert first["saved_s"] == 0.0
    assert first["lag_s"] == pytest.approx(ran.world.thermal.unit_lag_s, rel=0.02)
    assert 0.0 < second["saved_s"] <= SLOT_s - LEAST_s
    assert second["bound_degC"] <= RESIDUAL_degC
    ended_ns = [t_ns for _, t_ns, _ in SessionReader(ran.whole).events("thermal_lag")]
    left_degC = float(ran.world.thermal.unit_degC(ended_ns[1])) - 31.0
    rows = read_view(ran.whole).rows
    print(f"{second['saved_s']:.0f} s saved; stated {second['bound_degC']:.4f} degC, true {left_degC:+.4f} degC")
    assert abs(left_degC) <= second["bound_degC"]
    assert rows[15].window.t_start_ns - ended_ns[1] == rows[0].window.t_start_ns - ended_ns[0]
    end = next(SessionReader(ran.whole).events("end"))[2]
    assert (end["slip_s"], end["overruns"], len(rows)) == (0.0, 0, 30)
    assert end["steps"] == len(ran.plan.steps)


def test_a_run_that_is_killed_inside_of_a_soak_goes_on_with_the_same_lag(
    ran: Ran, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its unit is warmed anew, and the first soak's lag ends this one too."""
    hurry(monkeypatch)
    folder = Path(shutil.copytree(ran.killed, tmp_path / ran.killed.name))
    assert [fields["saved_s"] for fields in events_of(folder, "thermal_lag")] == [0.0]
    assert go_on(folder).outcome.error is None
    assert len(read_view(folder).rows) == 30
    first, second = events_of(folder, "thermal_lag")
    assert first == events_of(ran.whole, "thermal_lag")[0]
    assert second["bound_degC"] <= RESIDUAL_degC
    assert second["saved_s"] > 0.0


def test_every_reader_of_a_session_takes_it(ran: Ran, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(ran.whole, tmp_path / ran.whole.name))
    view = read_view(folder)
    results, analysis = analyse_view(view)
    (folder / "results.json").write_text(results_json(results))
    assert replay(folder, as_json=False) == ExitStatus.PASS
    report = report_of(view, results, analysis).html()
    assert "Soaks by the thermal lag" in report
    state = Past().final(folder)
    assert (state["records"]["done"], state["records"]["planned"]) == (30, 30)
