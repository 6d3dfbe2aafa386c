"""A simulated north finder for tests, without a controller: power, rotation, frames by an own reader."""

import binascii
import struct

import numpy as np

from bench.model.clock import VirtualClock
from sim_instruments.worlds.simulation import open_world

BAUD = 460_800
LENGTH = 20  # sync, counter, output, encoder, temperature, status, check
QUIET = {"noise": "off", "wobble_arcmin": "0", "placement_arcmin": "0"}


class Rig:
    """A bench with the gyroscope's port open; the table turns as told, with 60 deg/s2."""

    def __init__(self, seed=1, **options):
        self.clock = VirtualClock()
        text = {name: str(value) for name, value in options.items()}
        self.world = open_world("fog_north", clock=self.clock, seed=seed, station={"instruments": {}}, options=text)
        self.unit = self.world.unit

    def power(self, on=True):
        self.unit.set_power(on, self.clock.now_ns(), 15.0 if on else 0.0)

    def listen(self):
        self.unit.connect("fog", BAUD, self.world.faults.link("fog"))

    def spin(self, rate_deg_s=360.0, acceleration_deg_s2=60.0):
        self.world.motion[0].run_at(rate_deg_s, acceleration_deg_s2, self.clock.now_ns())

    def read(self):
        return frames(self.unit.read("fog", 10**8))


def running(seed=1, rate_deg_s=360.0, **options):
    """A rig whose table has come to speed, at 20 s; samples from 2 s on."""
    rig = Rig(seed, **options)
    rig.listen()
    rig.power()
    rig.spin(rate_deg_s)
    rig.clock.sleep(20.0)
    return rig


def frames(received):
    """Rows of counter, volt, degrees, degC, status; every byte belongs to a sound frame."""
    assert len(received) % LENGTH == 0
    rows = []
    for at in range(0, len(received), LENGTH):
        frame = received[at : at + LENGTH]
        assert frame[:2] == b"\xf0\x6e"
        assert struct.unpack("<H", frame[-2:])[0] == binascii.crc_hqx(frame[2:-2], 0xFFFF)
        counter, output, encoder, temperature, status = struct.unpack("<IiIhH", frame[2:-2])
        rows.append((counter, 1e-6 * output, encoder * 360.0 / 2**24, 0.01 * temperature, status))
    return np.array(rows).reshape(-1, 5)


def heading_of(output_V, encoder_deg):
    """Heading of the sensing axis at encoder zero by a least-squares sine of the encoder angle, and its amplitude."""
    angle = np.deg2rad(encoder_deg)
    columns = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    east_like, north_like, _ = np.linalg.lstsq(columns, output_V, rcond=None)[0]
    return (90.0 - np.rad2deg(np.arctan2(north_like, east_like))) % 360.0, np.hypot(east_like, north_like)
