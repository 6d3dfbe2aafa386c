"""Constant and varying parameters side by side: the same headings, other sets, other figures; nothing where none is
named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from north_coverage import eight_of, rows_of, waveform_of

from bench.model.clock import NS, VirtualClock
from bench.systems.north.report import error_table, parameter_table, result_table
from bench.systems.north.sets import NorthSet
from bench.systems.north.solution import METHODS, Site, Solution
from bench.systems.north.solve import solve
from bench.systems.north.wording import method_name
from sim_instruments.worlds.north.world import FogWorld

HEADS_deg = tuple(float(head) for head in range(10, 370, 45))
KINDS = {"TIP": "constant", "TVP": "slow"}
MARK_deg = 20.0


def a_set(item: str, head_deg: float, repeat: int, kind: str, rng: np.random.Generator, t_s: float) -> NorthSet:
    u_V, theta_deg = waveform_of(KINDS.get(kind, "constant"), MARK_deg + head_deg, 0.0, rng)
    own = NorthSet(item, "mark", head_deg, repeat, 360.0, *eight_of(u_V), parameters=kind, begin_s=t_s, end_s=t_s)
    own.rows = rows_of(u_V, theta_deg)
    return own


@pytest.fixture(scope="module")
def both() -> Solution:
    """Without noise: two sets of calibration, then every heading with constant and with varying parameters."""
    rng = np.random.default_rng(17)
    sets = [a_set("calibration", 0.0, repeat, "", rng, repeat) for repeat in (1, 2)]
    for kind in KINDS:
        sets += [a_set("test", head_deg, 1, kind, rng, 10.0 + len(sets)) for head_deg in HEADS_deg]
    return solve(sets, Site(37.0, MARK_deg))


def test_each_kind_has_its_own_errors_and_no_mean_of_both(both: Solution) -> None:
    """Without noise constant parameters leave nothing; varying ones turn the paper's formulas by degrees, and least
    squares by a sixth of one (prototypes of the design: 3.6 and 0.16 deg RMS)."""
    (table,) = parameter_table(both)
    names = {method_name(method): method for method in (*METHODS, "literal")}
    rows = {names[row[0]]: dict(zip(table.headers, row, strict=True)) for row in table.rows}
    constant, varying = ({name: float(row[f"{kind}: RMS, deg"]) for name, row in rows.items()} for kind in KINDS)
    assert constant["least_squares"] == constant["likelihood"] == constant["quadrant"] == 0.0
    assert varying["quadrant"] > 1.0
    assert 0.0 < varying["likelihood"] < 0.3
    assert 0.0 < varying["least_squares"] < 0.3
    assert {rows["literal"][f"{kind}: more than 90 deg off"] for kind in KINDS} == {4}  # on half of the circle
    assert len(both.means("least_squares")) == 2 * len(HEADS_deg)
    assert len(error_table(both)[0].rows) == 2 * len(HEADS_deg)
    assert [row[2] for row in result_table(both, "least_squares", 1.0).rows] == ["TIP"] * 8 + ["TVP"] * 8


def test_sets_that_name_no_parameters_are_not_divided(both: Solution) -> None:
    plain = solve([a_set("test", 30.0, 1, "", np.random.default_rng(3), 1.0)], Site(37.0, MARK_deg))
    assert parameter_table(plain) == []
    assert plain.kinds == [""]
    assert "parameters" not in result_table(plain, "likelihood", 1.0).headers


def world(**options: Any) -> FogWorld:
    clock = VirtualClock()
    return FogWorld(
        clock=clock, seed=5, options={"noise": False, "wobble_arcmin": 0.0, "placement_arcmin": 0.0, **options}
    )


def test_a_person_lets_the_parameters_of_the_bench_vary_and_be_constant_again() -> None:
    asked, never, always = world(), world(), world(parameters="slow")
    for bench in (asked, never, always):
        bench.motion[0].run_at(360.0, 60.0, 0)
    for at_s, kind in ((30.0, "TVP"), (60.0, "TIP")):
        asked.clock.sleep(at_s - asked.clock.now_ns() / NS)
        asked.operate("parameters", kind)
    number = np.arange(20_000, 80_000)
    output_V, plain_V, slow_V = (bench.sensor.output_V(number) for bench in (asked, never, always))
    varied = (number >= 30_000) & (number < 60_000)
    np.testing.assert_array_equal(output_V[~varied], plain_V[~varied])
    np.testing.assert_array_equal(output_V[varied], slow_V[varied])
    large = varied & (np.abs(plain_V) > 0.5)
    gain = output_V[large] / plain_V[large]
    assert 0.8 - 1e-9 <= gain.min() < 0.9
    assert 1.1 < gain.max() <= 1.2 + 1e-9
