"""What the tests of the simulated GNC bench share: a bench on a virtual clock, and a host that packs bytes itself.

Frames and payloads are packed and taken apart here by hand, with the check of the standard library (crc_hqx is
CRC-16/CCITT-FALSE with 0xFFFF to begin with): not with the frame file that the simulated board uses.
"""

import binascii
import pickle
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvisa
from pyvisa.resources import MessageBasedResource
from rehearsal import recorded, rehearsed
from sim_bench import bare_world

from bench.analysis import Exchange, Material, Reading
from bench.commands.check import checked_plan
from bench.commands.run import view_of
from bench.frame import load_frame
from bench.model.clock import NS, VirtualClock
from bench.model.drivers import driver_class
from bench.session.view import KEPT_EVENTS, analyse_view
from sim_instruments.worlds.gnc.world import GncBoard
from sim_instruments.worlds.simulation import open_world

SUPPLY, DMM = "GPIB0::5::INSTR", "GPIB0::23::INSTR"
STATION = {
    "instruments": {
        "supply": {"driver": "hp_6632b", "resource": SUPPLY},
        "rail_dmm": {"driver": "agilent_34401a", "resource": DMM},
    },
    "links": {"rs422": {"frame": "gnc_422", "baud": 921600}},
}
COMMAND, ANSWER, STREAM, REFUSAL = 0x01, 0x81, 0x02, 0x7F
BAUD = 921_600
STEP_S = 0.002
PATIENCE_S = 2.5


@dataclass(frozen=True)
class Frame:
    """One frame from the board."""

    destination: int
    source: int
    sequence: int
    kind: int
    command: int
    payload: bytes


def packed(command: int, payload: bytes = b"", *, sequence: int = 0, destination: int = 0x10, source: int = 1) -> bytes:
    body = struct.pack("<6BH", 1, destination, source, sequence, COMMAND, command, len(payload)) + payload
    return b"\xeb\x90" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def frames_in(received: bytes) -> list[Frame]:
    """All sound frames, found by going on one byte behind anything else."""
    found, at = [], 0
    while (at := received.find(b"\xeb\x90", at)) >= 0:
        if at + 12 <= len(received):
            stop = at + 10 + int.from_bytes(received[at + 8 : at + 10], "little")
            body = received[at + 2 : stop]
            if (
                stop + 2 <= len(received)
                and struct.pack("<H", binascii.crc_hqx(body, 0xFFFF)) == received[stop : stop + 2]
            ):
                found.append(Frame(*body[1:6], body[8:]))
                at = stop + 2
                continue
        at += 1
    return found


class Host:
    """A bench with a GNC module, and what a person and a controller do with it."""

    def __init__(self, seed: int, options: Mapping[str, str], serial: str) -> None:
        self.clock = VirtualClock()
        self.world = open_world("gnc_module", clock=self.clock, seed=seed, station=STATION, options=options)
        self.world.operate("unit", serial)
        self.board: GncBoard = self.world.unit
        self.board.connect("rs422", BAUD, self.world.faults.link("rs422"))
        self._sequence = 0
        self._manager: pyvisa.ResourceManager | None = None

    def close(self) -> None:
        if self._manager is not None:
            self._manager.close()
        self.world.close()

    def instrument(self, address: str):
        self._manager = self._manager or pyvisa.ResourceManager(self.world.visa_library)
        return self._manager.open_resource(address, read_termination="\n", write_termination="\n")

    def power(self, on: bool = True) -> None:
        self.board.set_power(on, self.clock.now_ns(), 5.0 if on else 0.0)

    def read(self) -> bytes:
        return self.board.read("rs422", 10_000_000)

    def exchange(self, command: int, payload: bytes = b"", sequence: int | None = None) -> Frame | None:
        """Send a command and wait for the frame that belongs to it; None if nothing comes."""
        if sequence is None:
            self._sequence = sequence = (self._sequence + 1) % 256
        self.board.write("rs422", packed(command, payload, sequence=sequence))
        deadline_ns = self.clock.now_ns() + int(PATIENCE_S * 1e9)
        received = b""
        while self.clock.now_ns() < deadline_ns:
            self.clock.sleep(STEP_S)
            if fresh := self.read():
                received += fresh
                for frame in frames_in(received):
                    if frame.kind != STREAM and (frame.sequence, frame.command) == (sequence, command):
                        return frame
        return None

    def ask(self, command: int, form: str = "", *values: int, extra: bytes = b"") -> tuple[int, bytes]:
        """Status and payload behind it; (-1, b"") if nobody answers."""
        frame = self.exchange(command, struct.pack("<" + form, *values) + extra)
        return (-1, b"") if frame is None else (frame.payload[0], frame.payload[1:])


@contextmanager
def open_host(
    seed: int = 1, serial: str = "GNC-01", *, on: bool = True, options: Mapping[str, str] | None = None
) -> Iterator[Host]:
    """A host whose module has booted."""
    host = Host(seed, options or {}, serial)
    try:
        if on:
            host.power()
            host.clock.sleep(1.6)
        yield host
    finally:
        host.close()


SHORT = ("position=60 s", "check_position=20 s", "warm_up=5 min")
HEAD_s = 1.0  # the second before the turn belongs to the record too
TURN_s = 21.3  # rotations of the recorded units, as shipped
RECORDED = {"gnc_magnetometer": ()}  # settings, by sequence; those of a calibration without
_SESSION = "session.pickle"
Key = tuple[Any, ...]


@dataclass(frozen=True)
class Session:
    """Estimates and truth by quantity and conditions; ``notes`` of the analysis."""

    found: dict[Key, dict[str, Any]]
    truth: dict[Key, float]
    notes: list[str]
    missing: list[str]

    def errors(self, *quantities: str) -> np.ndarray:
        """(n, 3): error, expanded uncertainty, standard uncertainty of each estimate of which there is a truth."""
        chosen = [(key, one) for key, one in self.found.items() if key in self.truth]
        return np.array(
            [
                (one["value"] - self.truth[key], one["expanded_uncertainty"], one["std_uncertainty"])
                for key, one in chosen
                if not quantities or key[0] in quantities
            ]
        )

    def matrix(self, quantity: str, *, true: bool = False) -> np.ndarray:
        """(3, 3) by row and column."""
        values = self.truth if true else {key: one["value"] for key, one in self.found.items()}
        matrix = np.zeros((3, 3))
        for key, value in values.items():
            place = dict(key[1:])
            if key[0] == quantity:
                matrix["xyz".index(place["row"]), "xyz".index(place["column"])] = value
        return matrix

    def by_axis(self, quantity: str, kind: str, *, true: bool = False) -> np.ndarray:
        """(3,) x, y, z."""
        values = self.truth if true else {key: one["value"] for key, one in self.found.items()}
        return np.array([values[_key(quantity, {"kind": kind, "axis": axis})] for axis in "xyz"])


def run_session(out: Path, sequence: str, number: int, *settings: str) -> Session:
    """One simulated unit; the number makes its serial number and the seed."""
    plan = checked_plan(sequence, None, [f"serial=U-{number:02}", *settings])
    done = rehearsed(out / f"{Path(sequence).stem}-{number}", plan, seed=100 + number, kept=KEPT_EVENTS).run
    assert done.outcome.error is None, done.outcome.error
    results, analysis = analyse_view(view_of(plan, done))
    found = {_key(one["quantity"], one["conditions"]): one for one in results["estimates"]}
    truth = {_key(one["quantity"], one["conditions"]): one["value"] for one in done.truth}
    return Session(found, truth, analysis.notes, analysis.missing)


def calibration_settings(length_s: float) -> tuple[str, ...]:
    """A short calibration with rotations recorded over some time."""
    return *SHORT, f"turn_record={length_s - HEAD_s:g} s"


def recorded_unit(factory: pytest.TempPathFactory, sequence: str) -> tuple[Path, Session]:
    """Folder and results of unit 0 in one sequence, run once per test run; for reading only."""
    out = recorded(factory, f"{sequence}_unit", partial(_record, sequence))
    (folder,) = (path for path in out.glob("*/*") if path.is_dir())
    return folder, pickle.loads((out / _SESSION).read_bytes())


def _record(sequence: str, out: Path) -> None:
    session = run_session(out, sequence, 0, *RECORDED.get(sequence, calibration_settings(TURN_s)))
    (out / _SESSION).write_bytes(pickle.dumps(session))


def _key(quantity: str, conditions: dict[str, Any]) -> Key:
    return quantity, *sorted(conditions.items())


def share_covered(sessions: list[Session], *quantities: str) -> float:
    """Per cent of the intervals that hold the truth."""
    errors = np.concatenate([one.errors(*quantities) for one in sessions])
    return 100.0 * float(np.mean(np.abs(errors[:, 0]) <= errors[:, 1]))


FRAME = Path(__file__).parents[3] / "frames" / "gnc_422.yaml"
SITE = {"latitude_deg": 37.5, "longitude_deg": 127.0, "height_m": 85.0, "gravity_m_s2": 9.798, "azimuth_deg": 90.0}
CAMPAIGN = {"analysis": "gnc_unit_test", "uut": {"model": "GNC", "serial": "GNC-01"}, "site": SITE}
PATTERN = bytes(range(16))


def sound_items() -> list[tuple[str, bytes, bytes]]:
    """(command, request, answer behind the status) of one whole unit test."""
    found = [("cpu", struct.pack("<I", 7), struct.pack("<4H4HHII", 50, 50, 50, 50, 0, 0, 0, 0, 0, 0, 0))]
    settings = (500, 1000, 2000, 5000)
    found += [("timer", struct.pack("<IB", us, 20), struct.pack("<20IB", *[us + 1] * 20, 20)) for us in settings]
    found += [("memory", _memory(*which, 0), _words(1024, 0)) for which in product((0, 1), (0, 1, 2))]
    for region in (2, 3):
        erases = 5
        for operation in (1, 2, 3, 4):
            erases += operation == 1
            found.append(("memory", _memory(region, 2, operation), _words(1024, erases)))
    found.append(("imu", bytes([50]), imu()))
    found.append(("gps", b"", struct.pack("<BBiiiH", 3, 9, 375_000_100, 1_270_000_000, 80_000, 900)))
    found += [("ad", bytes([dip]), ad(dip)) for dip in range(1, 6)]
    for output, source in permutations((1, 2, 3, 4), 2):
        found += [("io", bytes([output, source, level]), bytes([level, 0])) for level in (0, 1)]
    found.append(("spi", struct.pack("<H", 0xA55A), struct.pack("<HH", 0xA55A, 0xA55A)))
    found.append(("sci", PATTERN, PATTERN))
    return [*found, ("can", struct.pack("<I", 0x123) + PATTERN, struct.pack("<I", 0x123) + PATTERN)]


def imu(rate: int = 100, force_z: int = 100_000, **changes: Any) -> bytes:
    """Means and extremes; LSB of the wire."""
    low = {"gyro": (-20, -20, -20), "accel": (-2, -2, 998)} | changes.get("low", {})
    high = {"gyro": (20, 20, 20), "accel": (2, 2, 1002)} | changes.get("high", {})
    means = struct.pack("<3i3ihh", rate, -rate, 0, 0, 0, force_z, 2512, 2498)
    extremes = struct.pack("<12i", *low["gyro"], *high["gyro"], *low["accel"], *high["accel"])
    return means + extremes + bytes([changes.get("samples", 50)])


def ad(dip: int, **changes: int) -> bytes:
    """Millivolt of the 8 channels with one DIP switch on."""
    volts = {"m1": 2560, "m2": 2470, "m3": 2450, "c1": 0, "c2": 0, "c3": 0, "c4": 0, "c5": 0}
    volts |= {f"c{number}": level for number, level in enumerate((5000, 3300, 1200, 0, 1730), 1) if number == dip}
    return struct.pack("<8h", *(volts | changes).values())


def _memory(region: int, pattern: int, operation: int) -> bytes:
    return struct.pack("<BBBII", region, pattern, operation, 0, 4096)


def _words(checked: int, erases: int) -> bytes:
    return struct.pack("<6I", checked, 0, 0, 0, 0, erases)


def exchange(name: str, sent: bytes, received: bytes, number: int = 0, **changes: Any) -> Exchange:
    """One exchange that takes 10 ms, one every 100 ms."""
    fields: dict[str, Any] = {
        "step": number, "item": name, "name": name, "sequence": number % 256, "attempts": 1,
        "begin_s": 100.0 + 0.1 * number, "end_s": 100.01 + 0.1 * number, "status": 0, "refused": False,
        "sent": sent, "received": received, "conditions": {"unit": "GNC-01"},
    }  # fmt: skip
    return Exchange(**(fields | changes))


def exchanges(unit: str = "GNC-01", first: int = 0) -> list[Exchange]:
    """All exchanges of a sound unit."""
    return [
        exchange(name, sent, received, first + number, conditions={"unit": unit})
        for number, (name, sent, received) in enumerate(sound_items())
    ]


def supply(volts: float | None = 5.01, amperes: float | None = 0.488, unit: str = "GNC-01") -> list[Reading]:
    """Readings of the supply before the tests."""
    about = {"unit": unit}
    return [
        Reading(90.0, 1, "rail_dmm", "measure_voltage", volts, about),
        Reading(91.0, 2, "supply", "measure_current", amperes, about),
    ]


def material(found: list[Exchange], readings: list[Reading] | None = None, **campaign: Any) -> Material:
    """What an analysis sees of these exchanges."""
    layouts = load_frame(FRAME).commands
    return Material(
        rows=(), campaign=CAMPAIGN | campaign, standards={}, exchanges=found, layouts=layouts,
        readings=supply() if readings is None else readings, utc_offset_s=946_684_800.0,
    )  # fmt: skip


ADDRESS = "GPIB0::12::INSTR"


class TableRig:
    """``driver`` and ``table`` (the simulator) of one world; ``resource`` for commands by hand."""

    def __init__(self, world: Any, manager: pyvisa.ResourceManager) -> None:
        self.world, self.clock, self.manager = world, world.clock, manager
        self.table = world.instruments["turntable"]
        self.driver = self.open()
        self.resource: Any = manager.open_resource(ADDRESS, read_termination="\n", write_termination="\n")

    def open(self) -> Any:
        """One more driver, as of another process."""
        resource = self.manager.open_resource(ADDRESS, resource_pyclass=MessageBasedResource)
        return driver_class("acutrol_3000")(
            resource, role="turntable", clock=self.clock, transcript=lambda *_: None, options={}
        )

    def ready(self, rate: float = 300.0, acceleration: float = 300.0) -> Any:
        """The driver with limits set and interlocks closed."""
        for axis in (1, 2, 3):
            self.driver.set_limits(axis, rate, acceleration)
        self.driver.close_interlock()
        return self.driver

    def send(self, *messages: str) -> None:
        """Commands by hand, as far apart as the controller wants them."""
        for message in messages:
            self.clock.sleep(0.2)
            self.resource.write(message)

    def ask(self, message: str) -> str:
        """A question by hand."""
        self.clock.sleep(0.2)
        return str(self.resource.query(message))

    def angles(self) -> list[float]:
        """True angles now, degree."""
        return [float(axis.motion.angle_deg(self.clock.now_ns())) for axis in self.table.axes]

    def rates(self) -> list[float]:
        """True rates now, deg/s."""
        return [float(axis.motion.rate_deg_s(self.clock.now_ns())) for axis in self.table.axes]

    def moved_deg(self, since_ns: int) -> float:
        """The longest way any axis has gone since then, degree."""
        times = np.linspace(since_ns, self.clock.now_ns(), 2000).astype(np.int64)
        return max(float(np.ptp(axis.motion.angle_deg(times))) for axis in self.table.axes)

    def since_s(self, began_ns: int) -> float:
        """Seconds of the bench since then."""
        return float(self.clock.now_ns() - began_ns) / NS


@contextmanager
def open_table(seed: int = 1) -> Iterator[TableRig]:
    """A bench with nothing but a turntable."""
    world = bare_world({"turntable": {"driver": "acutrol_3000", "resource": ADDRESS, "options": {}}}, seed)
    manager = pyvisa.ResourceManager(world.visa_library)
    try:
        yield TableRig(world, manager)
    finally:
        manager.close()
        world.close()
