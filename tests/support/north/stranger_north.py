"""A turning gyroscope and two lock-in amplifiers as a stranger records them; angles by plain trigonometry."""

from typing import Any

import numpy as np
from stranger_page import Session, documented_campaign, packed, shipped

RATE_Hz, SECONDS = 1000, 2
AXIS_deg, SOUGHT_deg = 20.0, 213.4  # of the sensing axis at zero: on the mark, and at the place to be found
HEADS_deg = (0.0, 60.0, 150.0, 270.0)
_LATE_deg, _GAINS = (7.0, -4.0), (1.01, 0.985)  # of the index pulses and lock-ins: found by the calibration
_FRAME = np.dtype(
    [("counter", "<u4"), ("output", "<i4"), ("encoder", "<u4"), ("temperature", "<i2"), ("status", "<u2")]
)


class _Bench:
    def __init__(self) -> None:
        self.session = Session(documented_campaign("fog_north"), {"fog": shipped("fog_1k")})
        self.rng, self.t_s, self.counter = np.random.default_rng(11), 1.0, 0

    def set_of_four(self, heading_deg: float, **conditions: Any) -> None:
        """The Earth's rate along the axis, 1 V at most, at four phases of both lock-ins."""
        for index in (1, 2, 3, 4):
            n = RATE_Hz * SECONDS
            theta_deg = 360.0 * (np.arange(n) + 0.5) / RATE_Hz
            output_V = 0.3 + np.cos(np.radians(heading_deg - theta_deg)) + self.rng.normal(0.0, 0.02, n)
            self._stream(output_V, theta_deg)
            begin_s = self.t_s - SECONDS
            said = {**conditions, "index": index}
            self.session.record(self.counter - n, n, begin_s, self.t_s, rate_deg_s=360.0, **said)
            for role, pulse_deg, late_deg, gain in zip(
                ("lock_in_1", "lock_in_2"), (270.0, 0.0), _LATE_deg, _GAINS, strict=True
            ):
                turned = np.radians(theta_deg - pulse_deg - late_deg - 90.0 * (index - 1))
                x_V = gain * np.sqrt(2.0) * float(np.mean(output_V * np.sin(turned)))
                value = {"x_V": x_V, "frequency_Hz": 1.0, "overload": False, "unlocked": False}
                self.session.reading(self.t_s + 0.5, role, "measure", value, **said)
            self.t_s += 1.0

    def _stream(self, output_V: Any, theta_deg: Any) -> None:
        body = np.zeros(len(output_V), _FRAME)
        body["counter"] = self.counter + np.arange(len(body))
        body["output"] = np.rint(output_V / 1e-6)
        body["encoder"] = np.rint(theta_deg % 360.0 / 360.0 * 2**24).astype(np.int64) % 2**24
        body["temperature"] = 2500
        frames = packed(b"\xf0\x6e", body, "crc-16/ibm-3740")
        for at in range(0, len(frames), 100):
            self.t_s += 100 / RATE_Hz
            self.session.frames("fog", self.t_s, b"".join(frames[at : at + 100]))
        self.counter += len(body)


def north_session() -> Session:
    """Calibration on the mark, four heads, and a place whose azimuth nobody told."""
    bench = _Bench()
    level = {"x_mrad": 0.0, "y_mrad": 0.0}
    bench.session.reading(0.5, "level", "measure", level)
    for repeat in (1, 2):
        bench.set_of_four(AXIS_deg, item="calibration", head_deg=0.0, repeat=repeat, place="mark")
    for head_deg in HEADS_deg:
        for repeat in (1, 2):
            bench.set_of_four(AXIS_deg + head_deg, item="test", head_deg=head_deg, repeat=repeat, place="mark")
    for repeat in (1, 2):
        bench.set_of_four(SOUGHT_deg, item="search", head_deg=0.0, repeat=repeat, place="field")
    return bench.session
