"""Histories for control charts: few parameters, many calibrations, of units that drift on their own."""

from __future__ import annotations

from typing import Any

import numpy as np
import store_sample
from store_sample import DAY_NS, START_NS, GAIN_ppm, OWN_ppm

from bench.store import record_calibration
from bench.store.reading import utc_text

Documents = list[tuple[dict[str, Any], dict[str, Any]]]


def unit(
    serial: str, days: np.ndarray, seed: int, gains_ppm: np.ndarray, steps_ppm: np.ndarray | None = None, **more: Any
) -> Documents:
    """(results.json, manifest) of a unit, a certificate of the calibrator each year, off by ``gains_ppm``.

    ``steps_ppm`` (n,) is what each calibration is off beside that; ``more``: station, simulated.
    """
    rng = np.random.default_rng(seed)
    level, rate = rng.normal(0.0, 300.0), rng.normal(0.0, 10.0)
    steps = np.zeros(days.size) if steps_ppm is None else steps_ppm
    return [
        _calibration(rng, serial, float(day), level + rate * float(day) / 365.25 + float(step), gains_ppm, more)
        for day, step in zip(days, steps, strict=True)
    ]


def _calibration(
    rng: np.random.Generator, serial: str, day: float, dsf_ppm: float, gains_ppm: np.ndarray, more: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    year = int(day // 365)
    where = {"channel": 1, "kind": "gyro", "temperature_degC": 20.0}
    std = float(np.hypot(OWN_ppm, GAIN_ppm))
    n_ppm, p_ppm = (dsf_ppm + gains_ppm[year] + rng.normal(0.0, OWN_ppm, 2)).tolist()
    estimates = [
        store_sample.estimate("dsf_n", "ppm", n_ppm, std, where),
        store_sample.estimate("dsf_p", "ppm", p_ppm, std, where),
        store_sample.estimate("bias", "A", 4e-7 + float(rng.normal(0.0, 2e-10)), 2e-10, where),
    ]
    stamp = utc_text(START_NS + round(day * DAY_NS)).replace("-", "").replace(":", "")
    document = store_sample.document(
        f"{stamp}_scale_factor_{serial}", f"{serial.lower()}{round(day * 1440):x}".rjust(64, "0"), estimates
    )
    document["uut"] = {"model": "NGU", "serial": serial}
    document["provenance"]["simulated"] = more.get("simulated", False)
    return document, store_sample.manifest(f"C-{year}") | {"station": more.get("station", "bench_1")}


def written(url: str, *histories: Documents) -> Documents:
    """Enter calibrations in order of time; return them so."""
    ordered = sorted((entry for history in histories for entry in history), key=lambda entry: entry[0]["session"])
    for document, manifest in ordered:
        record_calibration(url, document, manifest, None)
    return ordered
