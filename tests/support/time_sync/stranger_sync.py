"""A flight of ``sync_physics`` round a turn as a stranger records it, in frames of docs/session-format.md."""

import numpy as np
from stranger_page import Session, documented_campaign, packed, shipped
from sync_physics import EGI_s, IMU_s, OFFSET_s, Recording

__all__ = ["OFFSET_s", "sync_session"]
IMU = np.dtype(
    [
        ("counter", "<u4"), ("tick", "<u8"), ("delta_angle", "<i4", 3), ("delta_velocity", "<i4", 3),
        ("temperature", "<i2"), ("status", "<u2"),
    ]
)  # fmt: skip
EGI = np.dtype(
    [
        ("counter", "<u4"), ("tick", "<u8"), ("latitude", "<f8"), ("longitude", "<f8"), ("height", "<f8"),
        ("velocity", "<f8", 3), ("attitude", "<f8", 3), ("position_sigma", "<f4"), ("mode", "<u2"), ("status", "<u2"),
    ]
)  # fmt: skip


def sync_session() -> Session:
    """Straight on, a turn of 90 deg, straight on: one record, each frame a message of its own."""
    (row,) = Recording(4).material().rows
    links = {"imu": (b"IM", IMU, IMU_s, row.samples), "egi": (b"EG", EGI, EGI_s, row.beside["egi"])}
    texts = {}
    for link, name, rate_Hz in (("imu", "imu_200", 200), ("egi", "egi_50", 50)):
        texts[link] = shipped(name).replace(f"rate: {rate_Hz} Hz", f"rate: {1.0 / links[link][2]:g} Hz")
    session = Session(documented_campaign("time_sync"), texts)
    for link, (sync, layout, _, samples) in links.items():
        assert samples is not None
        body = np.zeros(len(samples), layout)
        body["counter"] = samples.counter
        for column, values in samples.columns.items():
            body[column] = values
        for frame, t_ns in zip(packed(sync, body, "crc-32/iso-hdlc"), samples.t_ns.tolist(), strict=True):
            session.frames(link, 1e-9 * t_ns, frame)
    window = row.window
    begin_s, end_s = 1e-9 * window.t_start_ns - 0.1, 1e-9 * window.t_end_ns + 0.5
    session.record(window.first_counter, window.frames, begin_s, end_s, **window.conditions)
    return session
