"""Clock errors of the unit at every temperature."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from bench.analysis import count_problem, estimate
from bench.systems.af_converter.constants import Campaign, Standards
from bench.systems.af_converter.estimators.clocks import clock_ratio, count_noise, master_clock_error
from bench.systems.af_converter.temperatures import unit_temperatures

if TYPE_CHECKING:
    from bench.record import RecordRow

_PPM = 1e6


def clock_estimates(rows: Iterable[RecordRow], campaign: Campaign, standards: Standards) -> list[dict[str, Any]]:
    """clock_ratio_error (r - 1) and master_clock_error at every temperature, from all good records taken there.

    The uncertainty takes the fraction of a pulse at the ends of a record as common to all of them: two steady clocks
    and records at a steady pace may cut every count at the same place, and nothing in a record tells.
    """
    members_at: dict[float, list[RecordRow]] = {}
    taken = list(rows)
    for row in taken:
        if not count_problem(row):
            members_at.setdefault(float(row.window.conditions["temperature_degC"]), []).append(row)
    known = unit_temperatures(taken)
    entries = []
    for nominal_degC, members in members_at.items():
        gate_s = np.array([int(row.sums["master_count"]) for row in members]) / campaign.master_Hz
        af_count = np.array([int(row.sums["af_clock"]) for row in members], dtype=np.float64)
        fg_count = np.array([int(row.sums.get("fg_count", 0)) for row in members], dtype=np.float64)
        conditions: dict[str, Any] = {"temperature_degC": nominal_degC}
        warmth = [known[row.window.number].value_degC for row in members if row.window.number in known]
        if warmth:
            conditions["unit_temperature_degC"] = float(np.mean(warmth))
        ratio = clock_ratio(af_count, gate_s, campaign.af_clock_Hz) - 1.0
        entries += _clock("clock_ratio_error", ratio, count_noise(af_count), 0.0, conditions)
        master = master_clock_error(fg_count, gate_s, campaign.fg_Hz)
        entries += _clock("master_clock_error", master, count_noise(fg_count), standards.function_generator, conditions)
    return entries


def _clock(quantity: str, values: Any, noise: Any, common: float, conditions: dict[str, Any]) -> list[dict[str, Any]]:
    seen = np.isfinite(values)
    n = int(seen.sum())
    if n == 0:
        return []
    std = float(np.hypot(np.mean(noise[seen]), common))
    value_ppm, std_ppm = float(np.mean(values[seen])) * _PPM, std * _PPM
    return [estimate(quantity, "ppm", value_ppm, std_ppm, conditions, n=n, dropped=int((~seen).sum()))]
