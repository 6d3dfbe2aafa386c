"""A temperature ramp with an open input as a stranger records it: windows of 100 s, a unit that lags behind its air."""

from __future__ import annotations

from typing import Any

import numpy as np
from stranger_af import THERMOMETER
from stranger_page import Session, documented_campaign, packed, shipped

WINDOW_s, LAG_s, K0_C = 100, 1200.0, 1e-7
COLD_degC, HOT_degC = 5.0, 35.0
BIAS_A, SLOPE_A_degC, WIDTH_A, PLAY_degC = 3e-8, 2e-10, 4e-9, 1.5  # at 20 degC; of the loop, and its half-width
BRANCHES = (("hold_start", 36), ("up", 180), ("hold_top", 36), ("down", 180), ("hold_end", 36))
FRAME = np.dtype([("counter", ">u2"), ("npp", ">u4", 10), ("ppp", ">u4", 10), ("clocks", ">u4", 3), ("status", ">u2")])


def _temperatures() -> tuple[Any, Any]:
    """Of the air and of the unit each 10 s, degC; an hour at rest is in front."""
    corners_s = np.cumsum([0, 3600, *(WINDOW_s * windows for _, windows in BRANCHES)])
    t_s = np.arange(0.0, corners_s[-1] + 1.0, 10.0)
    air = np.interp(t_s, corners_s[2:5], [COLD_degC, HOT_degC, HOT_degC])
    down = t_s > corners_s[4]
    air[down] = np.interp(t_s[down], corners_s[4:6], [HOT_degC, COLD_degC])
    unit = air.copy()
    for k in range(1, t_s.size):
        unit[k] = unit[k - 1] + (air[k - 1] - unit[k - 1]) * 10.0 / LAG_s
    return air, unit


def _bias_A(unit: Any) -> Any:
    """A line over temperature, and half of the loop that follows the turns of the temperature with some play."""
    state, states = -1.0, []
    for step in np.diff(unit, prepend=unit[0]):
        state = min(1.0, max(-1.0, state + step / PLAY_degC))
        states.append(state)
    return BIAS_A + SLOPE_A_degC * (unit - 20.0) - 0.5 * WIDTH_A * np.array(states)


def ramp_session() -> Session:
    """There and back, channel 7 alone has a converter."""
    campaign = documented_campaign("scale_factor") | {"analysis": "bias_ramp"}
    channel = {"number": 7, "kind": "accelerometer", "k0_C": K0_C, "full_scale_A": 0.0242, "sensor_full_scale": 20.2}
    campaign["channels"] = [campaign["channels"][0] | channel | {"sensor_unit": "g"}]
    thermometer = THERMOMETER.replace("rate: 1 Hz", "rate: 0.02 Hz")
    session = Session(campaign, {"port_a": shipped("ngu_a_100s"), "port_b": thermometer})
    air, unit = _temperatures()
    for k in range(0, air.size, 6):
        session.event("environment", 10.0 * k, air_degC=air[k], unit_degC=unit[k])
    for number, k in enumerate(range(0, air.size, 5)):
        body = np.array([(number, round(100.0 * unit[k]))], [("counter", "<u2"), ("unit_temperature", "<i2")])
        session.frames("port_b", 10.0 * k, packed(b"TH", body, "crc-16/ibm-3740")[0])
    _windows(session, unit)
    return session


def _windows(session: Session, unit: Any) -> None:
    rng, total = np.random.default_rng(8), sum(windows for _, windows in BRANCHES)
    charge_C = _bias_A(unit)[360:-1].reshape(total, 10).mean(axis=1) * WINDOW_s
    charge_C = charge_C + rng.normal(0.0, 2e-9 * WINDOW_s**0.5, total)
    body = np.zeros(total, FRAME)
    body["counter"] = np.arange(total)
    body["ppp"][:, 6] = np.diff(np.floor(np.concatenate(([0.0], np.cumsum(charge_C))) / K0_C))
    body["clocks"] = (25_600_000, 1_000_000_000, 1_000_000_000)
    frames = packed(b"\xeb\xa0", body, "crc-16/ibm-3740", "big")
    branches = [name for name, windows in BRANCHES for _ in range(windows)]
    for number, (frame, branch) in enumerate(zip(frames, branches, strict=True)):
        begin_s = 3600.0 + WINDOW_s * number
        session.frames("port_a", begin_s + WINDOW_s, frame)
        session.record(number, 1, begin_s, begin_s + WINDOW_s, samples=False, route="open", branch=branch)
