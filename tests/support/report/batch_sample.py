"""Results of many units, as analyses give them; seeded, no physics."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.analysis import Analysis, build_results, estimate

SEED = 5
LIMIT = 1e-3


def provenance(simulated: bool = True) -> dict[str, Any]:
    hashes = dict.fromkeys(("plan_sha256", "frame_sha256", "session_sha256"), "0" * 64)
    return {"simulated": simulated, **hashes, "software": "test 0"}


def results(
    session: str, serial: str, estimates: list[dict[str, Any]], *, simulated: bool = True, incomplete: bool = False,
    campaign: str = "imu_calibration",
) -> dict[str, Any]:  # fmt: skip
    """The document results.json of a session."""
    analysis = Analysis(campaign, "ls", {"model": "GNC", "serial": serial}, estimates)
    return build_results(session, analysis, {}, provenance(simulated), {"rule": "simple"}, incomplete=incomplete)


def coupling(value: float, axis: str = "x", unit: str = "", u: float = 2e-5) -> dict[str, Any]:
    """A judged estimate of one axis; ``unit``: whose it is in a session of several."""
    where = {"kind": "gyro", "row": "x", "column": axis, **({"unit": unit} if unit else {})}
    return estimate("gyro_cross_coupling", "1", value, u, where, n=6, limit=LIMIT)


def calibrated(serial: str, rng: np.random.Generator) -> dict[str, Any]:
    """A calibration of one unit: couplings, scale errors, a matrix without limits, and a count that must be zero."""
    found = []
    for axis in "xyz":
        where = {"kind": "gyro", "axis": axis}
        found.append(coupling(float(rng.normal(0.0, 2.6e-4)), axis))
        found.append(estimate("gyro_scale_error", "ppm", float(rng.normal(0, 4000)), 9.0, where, n=6))
        stability = float(rng.normal(5.9, 0.3))
        found.append(estimate("gyro_bias_stability", "deg/h", stability, 0.2, where, n=360, limit=10.0))
        for column in "xyz":
            value = float(rng.normal(float(axis == column), 2e-4))
            found.append(estimate("gyro_matrix", "1", value, 1e-5, {"row": axis, "column": column}, n=6))
    found.append(estimate("memory_wrong", "1", float(rng.random() < 0.02), 0.0, {"item": "memory"}, n=14, limit=0.0))
    return results(f"20000101T000000Z_gnc_imu_calibration_{serial}", serial, found)


def calibrations(count: int) -> list[dict[str, Any]]:
    """Calibrations of ``count`` units."""
    rng = np.random.default_rng(SEED)
    return [calibrated(f"GNC-{number:03d}", rng) for number in range(1, count + 1)]
