"""Documents of calibrations that never were: one unit with a plausible drift, seen through one calibrator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.store.reading import utc_text

CHANNELS = range(1, 11)
TEMPERATURES_degC = (-10.0, 5.0, 20.0, 35.0, 50.0)
GAIN_ppm, OWN_ppm, BIAS_NOISE_A = 10.0, 2.0, 2e-10
START_NS = 1_400_000_000_000_000_000
DAY_NS = 86_400_000_000_000
FACTOR = 1.959963984540054


@dataclass(frozen=True)
class Drift:
    """How a unit changes, per year, and from which calibration on another calibrator certificate is used."""

    dsf_ppm: float = 12.0
    bias_A: float = 1e-9
    certificate_days: int = 365


def kind_of(channel: int) -> str:
    return "gyro" if channel <= 6 else "accelerometer"


def estimate(quantity: str, unit: str, value: float, std: float, conditions: dict[str, Any], **more: Any) -> Any:
    return {
        "quantity": quantity, "unit": unit, "value": value, "std_uncertainty": std, "coverage_factor": FACTOR,
        "expanded_uncertainty": FACTOR * std, "conditions": conditions, "n": 14, "dropped": 0, "limit": None,
        "verdict": "none", **more,
    }  # fmt: skip


def standards(certificate: str = "C-0") -> dict[str, Any]:
    relative = [{"range_A": 2.2e-4, "relative": 2e-5, "floor_A": 6e-9}, {"range_A": 2.2, "relative": 3.2e-5}]
    entry = {"model": "5720A", "serial": "77", "certificate": certificate, "calibrated": "2014-01-01"}
    return {"calibrator": {**entry, "due": "2015-01-01", "uncertainty": relative}}


def manifest(certificate: str = "C-0") -> dict[str, Any]:
    channels = [{"number": one, "stability_limit_ppm": 100.0 if one <= 6 else 200.0} for one in CHANNELS]
    return {
        "sequence": "scale_factor_38h", "station": "made_up", "standards": standards(certificate),
        "campaign": {"analysis": "scale_factor", "channels": channels},
    }  # fmt: skip


def document(session: str, sha256: str, estimates: list[Any], **changes: Any) -> dict[str, Any]:
    provenance = {
        "simulated": False, "plan_sha256": "p", "frame_sha256": "f", "session_sha256": sha256, "software": "made up 1",
    }  # fmt: skip
    return {
        "schema": 1, "session": session, "campaign": "scale_factor", "method": "gls",
        "uut": {"model": "NGU", "serial": "A1"}, "estimates": estimates,
        "quality": {"records": 750, "frames": 10, "frames_bad": 0, "frames_lost": 0, "splices": 0, "retaken": 0},
        "provenance": provenance, "notes": ["made up"], **changes,
    }  # fmt: skip


def calibrations(
    count: int, every_days: float, seed: int, drift: Drift | None = None
) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """(results.json, manifest) of ``count`` calibrations, 200 estimates each, in order of time.

    Every certificate of the calibrator has one gain error that all results share; the rest is noise of each.
    """
    rng = np.random.default_rng(seed)
    drift = drift or Drift()
    truth = {key: rng.normal(0.0, 400.0, 2) for key in ((c, t) for c in CHANNELS for t in TEMPERATURES_degC)}
    gains: dict[int, float] = {}
    found = []
    for number in range(count):
        years = number * every_days / 365.25
        certificate = int(number * every_days // drift.certificate_days)
        gain_ppm = gains.setdefault(certificate, rng.normal(0.0, GAIN_ppm))
        estimates = [
            one
            for (channel, warmth), dsf in truth.items()
            for one in _place(rng, channel, warmth, dsf + drift.dsf_ppm * years + gain_ppm, drift.bias_A * years)
        ]
        started_ns = START_NS + round(number * every_days * DAY_NS)
        stamp = utc_text(started_ns).replace("-", "").replace(":", "")
        name = f"{stamp}_scale_factor_38h_A1"
        found.append((document(name, f"{number:064x}", estimates), manifest(f"C-{certificate}")))
    return found


def _place(rng: Any, channel: int, warmth_degC: float, dsf_ppm: Any, bias_A: float) -> list[Any]:
    where = {"channel": channel, "kind": kind_of(channel), "temperature_degC": warmth_degC}
    where["unit_temperature_degC"] = warmth_degC + rng.normal(0.0, 0.01)
    std_ppm = float(np.hypot(OWN_ppm, GAIN_ppm))
    n_ppm, p_ppm = dsf_ppm + rng.normal(0.0, OWN_ppm, 2)
    return [
        estimate("dsf_n", "ppm", float(n_ppm), std_ppm, where),
        estimate("dsf_p", "ppm", float(p_ppm), std_ppm, where),
        estimate("dsf_asymmetry", "ppm", float(n_ppm - p_ppm), OWN_ppm * 2**0.5, where),
        estimate("bias", "A", 4e-7 + bias_A + rng.normal(0.0, BIAS_NOISE_A), BIAS_NOISE_A, where),
    ]
