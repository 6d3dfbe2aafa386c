"""Commands of the test board: how long it takes, what it answers.

Payloads are packed here by hand (little endian), apart from the frame file the controller reads.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Generator
from enum import IntEnum
from typing import Protocol

import numpy as np

from bench.model.clock import NS
from sim_instruments.worlds.gnc.imu import MAG_LSB_GAUSS
from sim_instruments.worlds.gnc.link import HIGHEST_HZ
from sim_instruments.worlds.gnc.magnetometer import Correction
from sim_instruments.worlds.gnc.module import GncModule
from sim_instruments.worlds.gnc.options import BY_CODE
from sim_instruments.worlds.gnc.peripherals import GIVE_UP_S, LINES, can_test, io_test, sci_test, spi_test
from sim_instruments.worlds.gnc.processor import FLASH, OPERATIONS, SIZE, TICKS, WORD, Operation, Region

PROTOCOL, FIRMWARE, BOARD_SERIAL = 1, 0x0102, "GNC-TB-SIM"
ANSWER_S = 0.002  # any command that does nothing slow
CPU_S, IMU_S, AD_S, IO_S, SPI_S = 0.5, 0.05, 0.02, 0.008, 0.01
TIMER_S = 0.02  # beside the intervals themselves
SCI_BAUD, CAN_S = 115_200, 0.01
IMU_RATE_HZ = 200
MOST_CAN_BYTES = 8
# Seconds for a whole memory, by what is done with it; a part takes its share.
MEMORY_S = {
    (Region.RAM, Operation.WRITE_READ): 0.06,
    (Region.SDRAM, Operation.WRITE_READ): 0.35,
    (Region.SPI_FLASH, Operation.ERASE): 1.40,
    (Region.SPI_FLASH, Operation.BLANK_CHECK): 0.10,
    (Region.SPI_FLASH, Operation.PROGRAM): 0.90,
    (Region.SPI_FLASH, Operation.VERIFY): 0.10,
    (Region.INTERNAL_FLASH, Operation.ERASE): 0.90,
    (Region.INTERNAL_FLASH, Operation.BLANK_CHECK): 0.05,
    (Region.INTERNAL_FLASH, Operation.PROGRAM): 0.60,
    (Region.INTERNAL_FLASH, Operation.VERIFY): 0.05,
}


class Status(IntEnum):
    """First byte of an answer; UNKNOWN_COMMAND and BAD_PARAMETER come as refusals."""

    PASS = 0
    FAIL = 1
    BUSY = 2
    UNKNOWN_COMMAND = 3
    BAD_PARAMETER = 4
    HARDWARE_ERROR = 5
    TIMEOUT = 6


class BadParameterError(Exception):
    """The board cannot do this; it says so and does nothing."""


# A command that was understood: yields how long it takes, gets when it ends, returns what is answered.
Job = Generator[float, int, tuple[Status, bytes]]


class Board(Protocol):
    """The test board, as its commands reach it."""

    module: GncModule
    correction: Correction
    dip_switch: Callable[[], int]

    @property
    def board_V(self) -> float:
        """Voltage at the 5 V test point."""

    def start_stream(self, sensors: int, rate_Hz: int, samples: int, t_ns: int) -> None:
        """Send samples from now on."""

    def stop_stream(self) -> int:
        """End the stream; returns how many samples it has sent."""


Handler = Callable[[Board, bytes], Job]


def _unpack(form: str, payload: bytes) -> tuple[int, ...]:
    if len(payload) != struct.calcsize(form):
        raise BadParameterError
    return struct.unpack(form, payload)


def _require(allowed: bool) -> None:
    if not allowed:
        raise BadParameterError


def _judged(good: bool) -> Status:
    return Status.PASS if good else Status.FAIL


def identify(board: Board, payload: bytes) -> Job:
    _require(not payload)
    serials = (text.encode("ascii", "replace")[:12].ljust(12) for text in (BOARD_SERIAL, board.module.serial))
    answer = struct.pack("<B12s12sH", PROTOCOL, *serials, FIRMWARE)
    yield ANSWER_S
    return Status.PASS, answer


def cpu(board: Board, payload: bytes) -> Job:
    (seed,) = _unpack("<I", payload)
    yield CPU_S
    result = board.module.processor.arithmetic(seed)
    numbers = (*[OPERATIONS] * 4, *result.wrong, result.memory_wrong, result.first_expected, result.first_received)
    return _judged(not any(result.wrong) and not result.memory_wrong), struct.pack("<9H2I", *numbers)


def timer(board: Board, payload: bytes) -> Job:
    setting_us, ticks = _unpack("<IB", payload)
    _require(100 <= setting_us <= 10_000 and 1 <= ticks <= TICKS)
    yield TIMER_S + ticks * setting_us * 1e-6
    intervals_us, interrupts = board.module.processor.timer_intervals_us(setting_us, ticks)
    padded = intervals_us + [0] * (TICKS - len(intervals_us))
    return Status.PASS, struct.pack("<20IB", *padded, interrupts)


def memory(board: Board, payload: bytes) -> Job:
    number, pattern, what, start, length = _unpack("<3B2I", payload)
    _require(number in tuple(Region) and what in tuple(Operation) and pattern <= 2)
    region, operation = Region(number), Operation(what)
    _require((operation is Operation.WRITE_READ) != (region in FLASH))
    _require(start % WORD == length % WORD == 0 and 0 < length <= SIZE[region] - start)
    yield ANSWER_S + MEMORY_S[region, operation] * length / SIZE[region]
    memories = board.module.memories
    result = memories.do(region, operation, pattern, start, length)
    numbers = (
        result.checked,
        result.wrong,
        result.address,
        result.expected,
        result.received,
        memories.erases[region],
    )
    return _judged(not result.wrong), struct.pack("<6I", *numbers)


def imu(board: Board, payload: bytes) -> Job:
    (samples,) = _unpack("<B", payload)
    _require(samples >= 1)
    end_ns = yield IMU_S + samples / IMU_RATE_HZ
    if "imu_bus_dead" in board.module.faults:
        return Status.HARDWARE_ERROR, bytes(3 * 4 * 6 + 5)
    t_ns = end_ns - NS // IMU_RATE_HZ * np.arange(samples, 0, -1, dtype=np.int64)
    counts = board.module.samples(t_ns, NS // IMU_RATE_HZ)
    gyro, accel, temperature = counts.gyro, counts.accel, counts.temperature
    means = (*np.rint(gyro.mean(axis=0) * 100), *np.rint(accel.mean(axis=0) * 100))
    warmth = (board.module.gyro_temperature(temperature).mean(), temperature.mean())
    extremes = (*gyro.min(axis=0), *gyro.max(axis=0), *accel.min(axis=0), *accel.max(axis=0))
    numbers = (*(int(v) for v in means), *(round(v) for v in warmth), *(int(v) for v in extremes), samples)
    return Status.PASS, struct.pack("<6i2h12iB", *numbers)


def gps(board: Board, payload: bytes) -> Job:
    _require(not payload)
    fix = board.module.receiver.hot_start()
    status = Status.PASS if fix.fix == 3 else Status.TIMEOUT if fix.fix == 0 else Status.FAIL
    if not board.module.receiver.alive:
        status = Status.HARDWARE_ERROR
    degrees = (round(fix.latitude_deg * 1e7), round(fix.longitude_deg * 1e7))
    numbers = (fix.fix, fix.satellites, *degrees, round(fix.height_m * 1e3), round(fix.time_to_fix_s * 1e3))
    answer = struct.pack("<2B3iH", *numbers)
    yield min(fix.time_to_fix_s, GIVE_UP_S)
    return status, answer


def ad(board: Board, payload: bytes) -> Job:
    (dip,) = _unpack("<B", payload)
    _require(dip <= 5)
    end_ns = yield AD_S
    field = board.module.field_counts(end_ns) * MAG_LSB_GAUSS
    sources_V = np.array([board.board_V, *board.module.power.rails_V, 0.0])
    read_V = board.module.converter.read_V(sources_V, board.dip_switch(), field)
    return Status.PASS, struct.pack("<8h", *(round(v * 1e3) for v in read_V))


def io(board: Board, payload: bytes) -> Job:
    output, source, level = _unpack("<3B", payload)
    _require(output in LINES and source in LINES and output != source and level <= 1)
    yield IO_S
    return Status.PASS, bytes(io_test(board.module.faults, output, source, level))


def spi(board: Board, payload: bytes) -> Job:
    (word,) = _unpack("<H", payload)
    yield SPI_S
    received, observed = spi_test(board.module.faults, word)
    return _judged(received == observed == word), struct.pack("<2H", received, observed)


def sci(board: Board, payload: bytes) -> Job:
    yield ANSWER_S + len(payload) * 10 / SCI_BAUD
    echo = sci_test(board.module.faults, payload)
    return Status.TIMEOUT if payload and not echo else _judged(echo == payload), echo


def can(board: Board, payload: bytes) -> Job:
    _require(4 <= len(payload) <= 4 + MOST_CAN_BYTES)
    (identifier,) = struct.unpack("<I", payload[:4])
    _require(identifier < 1 << 29)
    yield CAN_S
    echoed = can_test(board.module.faults, identifier, payload[4:])
    if echoed is None:
        return Status.HARDWARE_ERROR, payload[:4]
    answer = struct.pack("<I", echoed[0]) + echoed[1]
    return _judged(answer == payload), answer


def stream_start(board: Board, payload: bytes) -> Job:
    sensors, rate_Hz, samples = _unpack("<BHI", payload)
    _require(1 <= sensors <= 7 and 1 <= rate_Hz <= HIGHEST_HZ)
    end_ns = yield ANSWER_S
    board.start_stream(sensors, rate_Hz, samples, end_ns)
    return Status.PASS, b""


def stream_stop(board: Board, payload: bytes) -> Job:
    _require(not payload)
    yield ANSWER_S
    return Status.PASS, struct.pack("<I", board.stop_stream())


def roll(board: Board, payload: bytes) -> Job:
    _require(not payload)
    end_ns = yield ANSWER_S
    roll_deg, corrected = board.correction.roll(board.module.field_counts(end_ns))
    return Status.PASS, struct.pack("<4h", round(roll_deg * 100), *corrected)


def set_magnetometer(board: Board, payload: bytes) -> Job:
    x, y, z, gain, sin_alpha = _unpack("<5h", payload)
    _require(gain > 0 and abs(sin_alpha) <= 30_000)
    yield ANSWER_S
    board.correction = Correction((x, y, z), gain * 1e-4, sin_alpha * 1e-5)
    return Status.PASS, b""


def inject(board: Board, payload: bytes) -> Job:
    (code,) = _unpack("<B", payload)
    _require(code in BY_CODE)
    yield ANSWER_S
    board.module.faults.add(BY_CODE[code])
    return Status.PASS, b""


HANDLERS: dict[int, Handler] = {
    0x01: identify, 0x10: cpu, 0x11: timer, 0x12: memory, 0x13: imu, 0x14: gps, 0x15: ad, 0x16: io, 0x17: spi,
    0x18: sci, 0x19: can, 0x20: stream_start, 0x21: stream_stop, 0x30: roll, 0x31: set_magnetometer, 0x7E: inject,
}  # fmt: skip
