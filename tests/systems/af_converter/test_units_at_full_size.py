"""Several units at the size of the shipped campaign, and over a hundred seeds; part of ``make sweep``."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import pytest
from rehearsal import ROOT, compiled, rehearsed
from scipy.stats import binom
from units_campaign import compared, events_of, normalised, single_values, units_plan

from bench.model.clock import NS
from bench.plan import Step
from bench.record import SessionReader
from bench.session.one_unit import serials_of, session_of_unit
from bench.session.service import read_view
from bench.session.units import finish_units
from bench.session.view import analyse_view
from sim_instruments.worlds.af_converter.slots import SEED_STEP
from sim_instruments.worlds.common.world import World


@pytest.mark.sweep
def test_units_agree_with_single_campaigns_as_often_as_chance_says(tmp_path: Path) -> None:
    """100 seeds: |E_n| <= 1 of each quantity as often as chance says of normal errors at k = 2, to 99.9 %."""
    inside: list[list[bool]] = []
    for seed in range(1, 101):
        folder = tmp_path / str(seed)
        folder.mkdir()
        run = rehearsed(folder, units_plan(folder), seed=seed).run
        for number, serial in enumerate(serials_of(SessionReader(run.folder).manifest)):
            with session_of_unit(run.folder, serial) as home:
                results, _ = analyse_view(read_view(home))
            alone = folder / serial
            alone.mkdir()
            several = compared(results, run.truth, serial)
            found = normalised(several, single_values(alone, seed + number * SEED_STEP))
            inside.append([abs(value) <= 1.0 for value in found])
        shutil.rmtree(folder)
    least, most = (int(binom.ppf(tail, len(inside), math.erf(math.sqrt(2.0)))) for tail in (0.0005, 0.9995))
    counts = [sum(column) for column in zip(*inside, strict=True)]
    print(f"within 1 of {len(inside)}: {counts}; by chance {least} to {most}")
    assert all(least <= count <= most for count in counts)


@pytest.mark.sweep
def test_a_unit_unplugged_in_hour_2_of_the_whole_campaign(tmp_path: Path) -> None:
    """The shipped campaign of four units: C is confirmed off, the others have all their records and results."""
    began_ns: list[int] = []
    pulled: list[int] = []

    def pull(world: World, step: Step) -> None:
        began_ns.append(world.clock.now_ns())
        if not pulled and world.clock.now_ns() - began_ns[0] >= 7200 * NS:
            pulled.append(step.number)
            world.switches.switch("unplug", "c_port_a")

    plan = compiled(ROOT / "sequences" / "scale_factor_units.yaml")
    run = rehearsed(tmp_path, plan, act=pull).run
    assert run.outcome.error is None
    assert run.outcome.unsafe == ()
    (out,) = events_of(run.folder, "unit_left_out")
    assert (out["uut"], out["slot"], out["confirmed"]) == ("SIM-3", "C", ["calibrator", "switch", "supply_c"])
    history = f"sqlite:///{tmp_path / 'history.sqlite'}"
    finished_of = {unit.serial: unit.finished for unit in finish_units(run.folder, history)}
    for serial in ("SIM-1", "SIM-2", "SIM-4"):
        finished = finished_of[serial]
        assert finished is not None
        assert (finished.results["quality"]["records"], finished.results.get("incomplete", False)) == (765, False)
        errors = compared(finished.results, run.truth, serial)
        print(serial, {name: f"{error:+.1f} ppm, u {own:.1f}" for name, (error, own) in errors.items()})
    page = (run.folder / "units" / "SIM-3" / "report.html").read_text()
    assert "unit SIM-3 in slot C is left out" in page
