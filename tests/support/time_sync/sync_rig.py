"""A simulated time-offset bench for tests, without a controller: power, flight, frames by an own reader."""

import struct
import zlib

import numpy as np

from bench.model.clock import VirtualClock
from sim_instruments.worlds.simulation import open_world

BAUDS = {"egi": 460_800, "imu": 460_800, "radar": 10_000_000}
# sync, fields behind it, and names of the columns they make
LAYOUTS = {
    "egi": (b"\x45\x47", struct.Struct("<IQ9dfHH"), 14),
    "imu": (b"\x49\x4d", struct.Struct("<IQ6ihH"), 10),
    "radar": (b"\x53\x52", struct.Struct("<IQdfd128hH"), 134),
}
QUIET = {"noise": "off", "tag_noise_s": "0", "jitter_s": "0"}
RAMP_DEG_S2 = 400.0


class Rig:
    """A bench with its ports open; everything that arrives is kept by port, with the time it was read."""

    def __init__(self, seed=1, listen=("egi", "imu", "radar"), **options):
        self.clock = VirtualClock()
        text = {name: str(value) for name, value in options.items()}
        self.world = open_world("time_sync", clock=self.clock, seed=seed, station={"instruments": {}}, options=text)
        self.unit = self.world.unit
        self.received = {name: [] for name in BAUDS}
        for name in listen:
            self.listen(name)

    def listen(self, name):
        self.unit.connect(name, BAUDS[name], self.world.faults.link(name))

    def power(self, on=True):
        self.unit.set_power(on, self.clock.now_ns(), 15.0 if on else 0.0)

    def poll(self, period_s=0.001):
        return self.clock.every(period_s, self.read)

    def read(self):
        for name in BAUDS:
            if self.unit.waiting(name):
                self.received[name].append((self.clock.now_ns(), self.unit.read(name, 10**8)))

    def turn(self, rate_deg_s):
        """Yaw rate of the vehicle: that of the table about up, the other way round."""
        self.world.motion[0].run_at(-rate_deg_s, RAMP_DEG_S2, self.clock.now_ns())

    def bytes_of(self, name):
        self.read()
        return b"".join(chunk for _, chunk in self.received[name])

    def rows(self, name):
        return frames(name, self.bytes_of(name))

    def tick_s(self, name):
        return 1e-7 * self.rows(name)[:, 1]


def flying(speed=100.0, seed=1, boot_s=4.0, **options):
    """A rig whose vehicle has just begun to fly."""
    rig = Rig(seed, **options)
    rig.power()
    rig.clock.sleep(boot_s)
    rig.world.operate("speed", speed)
    return rig


def turning(rate_deg_s=4.5, before_s=10.0, turn_s=10.0, after_s=5.0, **options):
    """A rig whose vehicle has flown straight, turned, and flown straight."""
    rig = flying(**options)
    rig.clock.sleep(before_s)
    rig.turn(rate_deg_s)
    rig.clock.sleep(turn_s)
    rig.turn(0.0)
    rig.clock.sleep(after_s)
    return rig


def frames(name, received):
    """Rows of the fields as numbers of the wire; every byte belongs to a sound frame, but for the last one's."""
    sync, layout, columns = LAYOUTS[name]
    length = len(sync) + layout.size + 4
    rows = []
    for at in range(0, len(received) - length + 1, length):
        frame = received[at : at + length]
        assert frame.startswith(sync), at
        assert struct.unpack("<I", frame[-4:])[0] == zlib.crc32(frame[2:-4])
        rows.append(layout.unpack(frame[2:-4]))
    return np.array(rows, float).reshape(-1, columns)
