"""A GNC module as a stranger records it: frames of docs/session-format.md, poses and sensors of ``imu_material``."""

import struct
from dataclasses import replace
from typing import Any

import numpy as np
from gnc_rig import sound_items
from imu_material import Rig, Unit, calibration, earth_rate, to_local
from stranger_page import Session, documented_campaign, packed, shipped

UNIT = Unit(vrw_g_rtHz=5e-4)
GYRO_S, ACCEL_S, GYRO_BIAS_deg_s = UNIT.gyro_S, UNIT.accel_S, UNIT.gyro_bias_deg_s  # rate = K output - bias
ACCEL_BIAS_g = -np.linalg.solve(ACCEL_S, UNIT.accel_bias_g)  # acceleration = K output + bias
MAGNETIC = {"x": 0.05, "y": -0.03, "gain": 1.04, "angle_deg": 1.5, "radius": 0.3}  # gauss
STEPS_deg_s = (0.0, 0.004, -0.003, 0.006, 0.001, -0.005)  # of six windows
LEVEL, OVER = (0.0, 0.0, 0.0), (0.0, 0.0, 180.0)
STREAM = np.dtype(
    [
        ("head", "u1", 6), ("length", "<u2"), ("counter", "<u4"), ("tick", "<u4"), ("count", "u1"), ("gyro", "<i4", 3),
        ("accel", "<i4", 3), ("mag", "<i4", 3), ("temperature", "<i2"),
    ]
)  # fmt: skip


def session_of(rig: Rig, analysis: str) -> Session:
    """The records of a rig as frames; the stream runs during records only."""
    campaign = documented_campaign("imu_calibration") | {"analysis": analysis, "rate_Hz": rig.rate_Hz}
    session = Session(campaign, {"rs422": shipped("gnc_422").replace("rate: 200 Hz", f"rate: {rig.rate_Hz:g} Hz")})
    for row in rig.rows:
        samples = row.samples
        assert samples is not None
        body = np.zeros(len(samples), STREAM)
        body["head"], body["length"], body["count"] = (1, 1, 16, 9, 2, 0x22), 47, 1
        body["counter"] = samples.counter
        for name, column in samples.columns.items():
            body[name] = column
        frames, chunk = packed(b"\xeb\x90", body, "crc-16/ibm-3740"), max(20, round(rig.rate_Hz / 10.0))
        begin_s, n = samples.t_ns[0] * 1e-9, len(samples)
        for at in range(0, n, chunk):
            session.frames("rs422", begin_s + (at + chunk) / rig.rate_Hz, b"".join(frames[at : at + chunk]))
        session.record(int(samples.counter[0]), n, begin_s, begin_s + n / rig.rate_Hz + 0.1, **row.window.conditions)
    return session


def calibration_session() -> Session:
    """Six positions and six rotations, once."""
    return session_of(calibration(Rig(5, UNIT), rest_s=10.0), "imu_calibration")


def at_rest() -> Rig:
    """Some minutes, at 10 samples a second."""
    rig = Rig(7, UNIT, 10.0)
    rig.rest(180.0, LEVEL, item="bias")
    return rig


def short_bias_session() -> Session:
    """Some minutes at rest."""
    return session_of(at_rest(), "imu_bias")


def bias_session() -> Session:
    """Some minutes at rest, a flip about x, an hour, six windows of ten minutes."""
    rig = at_rest()
    for pose in (LEVEL, OVER):
        rig.rest(180.0, pose, item="flip")
    rig.rest(3600.0, LEVEL, item="stability")
    for step_deg_s in STEPS_deg_s:
        rig.unit = replace(UNIT, gyro_bias_deg_s=UNIT.gyro_bias_deg_s + step_deg_s)
        rig.rest(600.0, LEVEL, item="repeatability")
        rig.t_s += 700.0
    return session_of(rig, "imu_bias")


def indicated_bias(table_rate: Any) -> Any:
    """What gyros at rest indicate beyond the Earth's rate: not compensated, so the scale errors of both are in it."""
    return (table_rate + GYRO_BIAS_deg_s) @ GYRO_S.T - table_rate


def earth_at_rest() -> Any:
    """(3,) Earth's rate in the body with all axes of the table at zero, deg/s."""
    return to_local(*LEVEL, "x").T @ earth_rate()


def magnetometer_session() -> Session:
    """Ten turns about body z, which points up."""
    rig = Rig(5, UNIT, 50.0)
    rig.spin(100.0, 36.0, MAGNETIC["radius"])
    return session_of(rig, "magnetometer")


SUPPLY_V, SUPPLY_A, WIDTH_m = 5.05, 0.48, 0.0258


def module_session(dead_line: bool = False) -> Session:
    """Every item of a sound module; ``dead_line``: IO 1 does not reach IO 2 at level 1."""
    campaign = documented_campaign("imu_calibration") | {"analysis": "gnc_unit_test"}
    session = Session(campaign, {"rs422": shipped("gnc_422")})
    session.event(
        "prompt", 1.0, step=1, text="Width?", confirm="measured", by="me", value=WIDTH_m, unit="m", low=None,
        high=0.026, quantity="width", conditions={},
    )  # fmt: skip
    session.reading(2.0, "supply", "measure_voltage", SUPPLY_V)
    session.reading(3.0, "supply", "measure_current", SUPPLY_A)
    identity = struct.pack("<B12s12sH", 1, b"BOARD".ljust(12), b"7".ljust(12), 3)
    for number, (item, sent, received) in enumerate([("identify", b"", identity), *sound_items()], 101):
        answer = b"\0\0" if dead_line and (item, sent) == ("io", b"\1\2\1") else received
        at_s = 10.0 + 0.5 * (number - 100)
        session.event(
            "exchange", at_s, step=number, item=item, name=item, role="rs422", sequence=number % 256, attempts=1,
            begin_ns=round(1e9 * at_s), end_ns=round(1e9 * (at_s + 0.1)), status=0, refused=False, sent=sent.hex(),
            received=answer.hex(), ignored=0, conditions={},
        )  # fmt: skip
    return session
