"""Options of the simulated ring-laser bench, and what holds where none is given."""

from __future__ import annotations

from typing import Any

OPTIONS = {"quantum_noise": "random walk of the laser's own quantum noise, 1.15e-4 deg/rt-h at 28 cm"}
NUMBERS = {
    "rate_deg_h": ("input rate, by default Earth's vertical component at latitude 37 deg", -1e5, 1e5),
    "dither_noise_ppm": ("standard deviation of the dither's amplitude", 0.0, 2e5),
    "beat_noise_ppm": ("noise of the comparators in parts of the beat's amplitude, 10000 = 1 %", 0.0, 1e5),
    "backscatter_drift_deg_h": ("how the phase of the backscatter drifts while the laser is on", -1e5, 1e5),
    "second_harmonic_ppm": ("second harmonic of the backscatter, in parts of the first", 0.0, 2e5),
}
TEXTS: dict[str, tuple[str, tuple[str, ...]]] = {}
USUAL: dict[str, Any] = {
    "quantum_noise": True,
    "rate_deg_h": 9.052,
    "dither_noise_ppm": 5e4,
    "beat_noise_ppm": 0.0,
    "backscatter_drift_deg_h": 0.0,
    "second_harmonic_ppm": 0.0,
}
