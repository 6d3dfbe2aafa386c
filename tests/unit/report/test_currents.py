"""The scale-factor error of a single level has the sign of the model, whichever way the current flows."""

from __future__ import annotations

import dataclasses

import fit_simulation as sim
import numpy as np
import pytest

from bench.analysis import Material
from bench.report import report_model
from bench.report.plots.currents import level_errors
from bench.systems.af_converter.scale_factor.analysis import analyse

SEED, LEVEL_A, FEWER = 4, 1e-2, 1e-3


@pytest.mark.parametrize("method", ["gls", "ols"])
def test_a_level_with_fewer_pulses_has_more_current_per_pulse(method: str) -> None:
    """All pulses of one level are made fewer by 1000 ppm: that level alone must say about 1000 ppm more than others."""
    switches = sim.Switches(calibrator_errors=False, noise=False, dsf_sigma_ppm=0.0, lag=False)
    campaign = sim.simulate(SEED, switches, {1: "gyro"}, temperatures=(20.0,))
    rows = []
    for row in campaign.rows:
        changed = row.window.conditions["current_A"] == LEVEL_A
        factor = 1.0 - FEWER if changed else 1.0
        rows.append(
            dataclasses.replace(row, sums=row.sums | {name: row.sums[name] * factor for name in ("npp", "ppp")})
        )
    found = analyse(Material(rows, campaign.campaign, campaign.standards), method)
    model = report_model({"estimates": found.estimates}, (), (), None, {}, residuals=found.residuals)
    errors = {one.current_A: ppm for one, ppm in level_errors(model)}
    assert len(errors) == 12
    for sign in (1.0, -1.0):
        others = [ppm for current_A, ppm in errors.items() if current_A * sign > LEVEL_A]
        assert errors[sign * LEVEL_A] - np.mean(others) == pytest.approx(1e6 * FEWER, rel=0.1)
