"""Points of an AF converter as a stranger records them: pulses by adding charge up, a meter beside, one temperature."""

from __future__ import annotations

from typing import Any

import numpy as np
from stranger_page import Session, documented_campaign, documented_standards, packed, shipped

SECONDS, PAUSE_s, RATE_Hz = 10, 1, 100
K0_C, BIAS_A = 1.25e-6, 3e-8
TRUTH_ppm = {"dsf_n": 412.0, "dsf_p": -230.0}
LEVELS_A = (1e-3, 1e-2, 1e-1)
METER_ZERO_A = 4e-9
THERMOMETER = """\
frame: thermometer
title: A stranger's thermometer
endian: little
sync: [0x54, 0x48]
rate: 1 Hz
fields:
  - {name: counter, type: u16, role: counter}
  - {name: unit_temperature, type: i16, scale: 0.01, unit: degC}
crc: {name: crc-16/ibm-3740, over: [counter, end], stored: little}
golden: 54 48 11 00 d3 07 40 d9
expect: {counter: 17, unit_temperature: 20.03}
"""
PORT_A = np.dtype(
    [("counter", ">u2"), ("npp", ">u2", 10), ("ppp", ">u2", 10), ("clocks", "u1", (3, 3)), ("status", ">u2")]
)
_CLOCKS = [list(int(count).to_bytes(3, "big")) for count in (2560, 100_000, 100_000)]


def _points() -> list[dict[str, Any]]:
    common = {"channel": 1, "kind": "gyro", "temperature_degC": 20.0, "repeat": 0}
    closed = [
        {"current_A": level_A, "polarity": polarity, "range_A": 2.2 * (level_A or LEVELS_A[0]), "route": "closed"}
        for level_A in (0.0, *LEVELS_A)
        for polarity in (1, -1)
    ]
    return [{**common, "route": "open"}, *({**common, **point} for point in closed)]


def _pulses(current_A: float, frames: int) -> tuple[Any, Any]:
    """N and P pulses of each frame: whole charges of a constant current, an error of the charge for each sign."""
    total_A = current_A - BIAS_A
    charge_C = K0_C * (1.0 + 1e-6 * TRUTH_ppm["dsf_n" if total_A > 0.0 else "dsf_p"])
    counts = np.diff(np.floor(np.arange(frames + 1) * abs(total_A) / RATE_Hz / charge_C + 0.5)).astype(int)
    return (counts, 0 * counts) if total_A > 0.0 else (0 * counts, counts)


def _said(session: Session, counter: int, current_A: float, seconds: int) -> int:
    """Frames of both ports over some seconds; returns the next counter."""
    n = seconds * RATE_Hz
    body = np.zeros(n, PORT_A)
    body["counter"] = (counter + np.arange(n)) % 65536
    body["npp"][:, 0], body["ppp"][:, 0] = _pulses(current_A, n)
    body["clocks"] = _CLOCKS
    frames = packed(b"\xeb\x90", body, "crc-16/ibm-3740", "big")
    for second in range(seconds):
        at = counter // RATE_Hz + second
        warm = np.array([(at, 2003)], [("counter", "<u2"), ("unit_temperature", "<i2")])
        session.frames("port_b", at + 1.0, packed(b"TH", warm, "crc-16/ibm-3740")[0])
        session.frames("port_a", at + 1.0, b"".join(frames[RATE_Hz * second : RATE_Hz * (second + 1)]))
    return counter + n


def converter_session(analysis: str, swapped: bool = False) -> Session:
    """Open input, zeros and levels of both polarities of channel 1; before each the readings of a meter."""
    standards = documented_standards()
    standards["calibrator"] |= {
        "uncertainty": [{"range_A": 2.2 * level_A, "relative": 2e-5, "floor_A": 1e-9} for level_A in LEVELS_A],
        "corrections": [],
    }
    if analysis == "dmm_method":
        meter = [{"range_A": level_A, "relative": 2e-5, "floor_A": 1e-9} for level_A in LEVELS_A]
        standards = {"dmm": {"model": "3458A", "serial": "1", "uncertainty": meter}}
    campaign = documented_campaign("scale_factor") | {"analysis": analysis}
    session = Session(campaign, {"port_a": shipped("ngu_a"), "port_b": THERMOMETER}, standards=standards)
    for number, level_A in enumerate(LEVELS_A if analysis == "dmm_method" else ()):
        _metered(session, 0.1 * number, level_A, 0.0, zero_range_A=level_A)
    counter, lead = 0, -1 if swapped else 1
    for point in _points():
        current_A = point.get("current_A", 0.0) * point.get("polarity", 0)
        if analysis == "dmm_method" and point["route"] == "closed":
            range_A = max(LEVELS_A[0], point["current_A"])
            _metered(session, counter / RATE_Hz + 0.4, range_A, abs(current_A))
        begin = _said(session, counter, current_A, PAUSE_s)
        counter = _said(session, begin, lead * current_A, SECONDS)
        session.record(begin, SECONDS * RATE_Hz, begin / RATE_Hz, counter / RATE_Hz, samples=False, **point)
    return session


def _metered(session: Session, t_s: float, range_A: float, current_A: float, **conditions: Any) -> None:
    """Three readings on one range; the meter has a zero of its own."""
    session.reading(t_s, "dmm", "configure_current", range_A, **conditions)
    for k in range(3):
        session.reading(t_s + 0.01 * (k + 1), "dmm", "measure_current", current_A + METER_ZERO_A, **conditions)
