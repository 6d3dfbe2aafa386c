"""A flight round a turn as two navigation units of a stranger record it, each by its own clock.

An ellipsoid that turns, its normal gravity, a path in the tangent plane; nothing of any simulator of this repository.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from stranger_page import Session, documented_campaign, packed, shipped

OFFSET_s, IMU_LATENCY_s, EGI_LATENCY_s = 0.0137, 0.0008, 0.008
SECONDS, IMU_s, EGI_s = 20.0, 0.005, 0.02
_LATITUDE, _LONGITUDE, _SPEED_m_s = np.radians(37.5), np.radians(126.95), 100.0
_EARTH_rad_s, _A_m, _F = 7.292115e-5, 6_378_137.0, 1.0 / 298.257223563
_E2 = _F * (2.0 - _F)
_TURN_s, _RATE = (5.0, 13.0), np.radians(90.0) / 8.0
IMU = np.dtype(
    [
        ("counter", "<u4"), ("tick", "<u8"), ("delta_angle", "<i4", 3), ("delta_velocity", "<i4", 3),
        ("temperature", "<i2"), ("status", "<u2"),
    ]
)  # fmt: skip
EGI = np.dtype(
    [
        ("counter", "<u4"), ("tick", "<u8"), ("place", "<f8", 3), ("velocity", "<f8", 3), ("attitude", "<f8", 3),
        ("sigma", "<f4"), ("mode", "<u2"), ("status", "<u2"),
    ]
)  # fmt: skip


def _level(latitude: Any, longitude: Any) -> Any:
    """North, east, down in Earth-fixed axes, rows, (..., 3, 3)."""
    sl, cl, so, co = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    zero = 0.0 * sl
    rows = [[-sl * co, -sl * so, cl], [-so, co, zero], [-cl * co, -cl * so, -sl]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _path(t_s: Any) -> tuple[Any, Any, Any, Any, Any]:
    """Position, velocity, acceleration (n, 3) in north, east, down of the origin; heading (rad) and its rate."""
    fine_s = np.linspace(-1.0, SECONDS + 1.0, 200_001)
    begin, end = _TURN_s
    into = np.clip((fine_s - begin) / (end - begin), 0.0, 1.0)
    rate = np.where((into > 0.0) & (into < 1.0), _RATE * (1.0 - np.cos(2.0 * np.pi * into)), 0.0)
    step = fine_s[1] - fine_s[0]
    heading = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step)))
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1) * _SPEED_m_s
    place = np.concatenate((np.zeros((1, 2)), np.cumsum(0.5 * (ahead[1:] + ahead[:-1]) * step, axis=0)))
    psi, psi_rate = np.interp(t_s, fine_s, heading), np.interp(t_s, fine_s, rate)
    zero = 0.0 * psi
    p = np.stack([np.interp(t_s, fine_s, place[:, 0]), np.interp(t_s, fine_s, place[:, 1]), zero - 3000.0], axis=1)
    v = np.stack([np.cos(psi), np.sin(psi), zero], axis=1) * _SPEED_m_s
    a = np.stack([-np.sin(psi), np.cos(psi), zero], axis=1) * (_SPEED_m_s * psi_rate)[:, None]
    return p, v, a, psi, psi_rate


def _earth_fixed(p: Any) -> Any:
    """Points of the tangent plane at the origin on the ellipsoid, (n, 3) m."""
    normal_m = _A_m / np.sqrt(1.0 - _E2 * np.sin(_LATITUDE) ** 2)
    out_m = normal_m * np.cos(_LATITUDE)
    origin = [out_m * np.cos(_LONGITUDE), out_m * np.sin(_LONGITUDE), normal_m * (1.0 - _E2) * np.sin(_LATITUDE)]
    return np.array(origin) + p @ _level(_LATITUDE, _LONGITUDE)


def _geodetic(x: Any) -> tuple[Any, Any, Any]:
    """Latitude, longitude (rad), height (m), by iteration."""
    out_m = np.hypot(x[:, 0], x[:, 1])
    latitude = np.arctan2(x[:, 2], out_m * (1.0 - _E2))
    for _ in range(8):
        normal_m = _A_m / np.sqrt(1.0 - _E2 * np.sin(latitude) ** 2)
        height_m = out_m / np.cos(latitude) - normal_m
        latitude = np.arctan2(x[:, 2], out_m * (1.0 - _E2 * normal_m / (normal_m + height_m)))
    return latitude, np.arctan2(x[:, 1], x[:, 0]), height_m


def _gravity_m_s2(latitude: Any, height_m: Any) -> Any:
    """Normal gravity of WGS 84 (Somigliana), with the free air."""
    sine2 = np.sin(latitude) ** 2
    at_zero = 9.7803253359 * (1.0 + 0.00193185265241 * sine2) / np.sqrt(1.0 - _E2 * sine2)
    return at_zero * (1.0 - 2.0 / _A_m * (1.0 + _F + 0.00344978650684 - 2.0 * _F * sine2) * height_m)


def _sensed(t_s: Any) -> tuple[Any, Any]:
    """Angular rate (rad/s) and specific force (m/s2) in forward, right, down, (n, 3); the vehicle stays level."""
    p, v, a, psi, psi_rate = _path(t_s)
    tangent = _level(_LATITUDE, _LONGITUDE)
    latitude, longitude, height_m = _geodetic(_earth_fixed(p))
    down = _level(latitude, longitude)[:, 2] @ tangent.T
    earth = tangent @ np.array([0.0, 0.0, _EARTH_rad_s])
    force = a + 2.0 * np.cross(earth, v) - _gravity_m_s2(latitude, height_m)[:, None] * down
    rate = earth + np.stack([0.0 * psi, 0.0 * psi, psi_rate], axis=1)
    forward = np.stack([np.cos(psi), np.sin(psi), 0.0 * psi], axis=1)
    right = np.stack([-np.sin(psi), np.cos(psi), 0.0 * psi], axis=1)
    return tuple(  # type: ignore[return-value]
        np.stack([np.sum(w * forward, axis=1), np.sum(w * right, axis=1), w[:, 2]], axis=1) for w in (rate, force)
    )


def _imu(rng: Any) -> tuple[Any, Any]:
    """Frames of the inertial unit and the times at which their samples are valid."""
    t_s = IMU_s * np.arange(1, round(SECONDS / IMU_s))
    rate, force = _sensed(t_s - 0.5 * IMU_s)
    body = np.zeros(t_s.size, IMU)
    body["counter"], body["temperature"] = 70_000 + np.arange(t_s.size), 2500
    body["tick"] = 3_500_000_000 + np.rint(t_s * 1e7).astype(np.int64)
    body["delta_angle"] = np.rint((rate * IMU_s + rng.normal(0.0, 1e-6, rate.shape)) / 1e-9)
    body["delta_velocity"] = np.rint((force * IMU_s + rng.normal(0.0, 1e-5, force.shape)) / 1e-8)
    return body, t_s


def _egi(rng: Any) -> tuple[Any, Any]:
    """Solutions of the EGI, whose clock is ahead by the offset."""
    t_s = 0.1 + EGI_s * np.arange(round((SECONDS - 0.2) / EGI_s))
    p, v, _, psi, _ = _path(t_s)
    p = p + rng.normal(0.0, 0.3, (1, 3))
    v = v + rng.normal(0.0, 0.005, v.shape)
    latitude, longitude, height_m = _geodetic(_earth_fixed(p))
    turn = _level(latitude, longitude) @ _level(_LATITUDE, _LONGITUDE).T
    zero, one = 0.0 * psi, 0.0 * psi + 1.0
    axes = np.stack([[np.cos(psi), -np.sin(psi), zero], [np.sin(psi), np.cos(psi), zero], [zero, zero, one]])
    attitude = turn @ np.moveaxis(axes, 2, 0)
    body = np.zeros(t_s.size, EGI)
    body["counter"], body["sigma"], body["mode"] = 17_500 + np.arange(t_s.size), 0.3, 3
    body["tick"] = 3_500_000_000 + np.rint((t_s + OFFSET_s) * 1e7).astype(np.int64)
    body["place"] = np.stack([np.degrees(latitude), np.degrees(longitude), height_m], axis=1)
    body["velocity"] = np.einsum("nij,nj->ni", turn, v)
    body["attitude"][:, 0] = np.degrees(np.arctan2(attitude[:, 2, 1], attitude[:, 2, 2]))
    body["attitude"][:, 1] = np.degrees(-np.arcsin(attitude[:, 2, 0]))
    body["attitude"][:, 2] = np.degrees(np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0])) % 360.0
    return body, t_s


def sync_session() -> Session:
    """Straight on, a turn of 90 deg, straight on: one record, each frame a message of its own."""
    rng = np.random.default_rng(4)
    session = Session(documented_campaign("time_sync"), {"imu": shipped("imu_200"), "egi": shipped("egi_50")})
    for link, sync, (body, t_s), latency_s in (
        ("imu", b"IM", _imu(rng), IMU_LATENCY_s),
        ("egi", b"EG", _egi(rng), EGI_LATENCY_s),
    ):
        stamps_s = 10.0 + np.maximum.accumulate(t_s + latency_s + rng.exponential(3e-4, t_s.size))
        for frame, stamp_s in zip(packed(sync, body, "crc-32/iso-hdlc"), stamps_s.tolist(), strict=True):
            session.frames(link, stamp_s, frame)
        if link == "imu":
            n = len(body)
    session.record(70_000, n, 10.0, 10.5 + SECONDS, item="time_sync", manoeuvre="turn", phase="all")
    return session
