"""Where bytes of a link come from: a port that is read, counted and opened again, and the buffer of an instrument."""

import fcntl
import os
import pty
import struct
import tty
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import serial
from plan_sample import planned
from run_rig import Rig, frame
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from bench.frame import load_frame
from bench.model.clock import NS, VirtualClock, to_ns
from bench.model.errors import InputError, InputErrors, InstrumentError, LinkError
from bench.model.lab import find_shipped
from bench.plan import Step, load_station
from bench.run.bus.opener import open_port
from bench.run.bus.port import InstrumentLink, PortLink, descriptor_of, kernel_counts
from bench.run.bus.reader import LinkReader, is_stale
from bench.run.links.unit import CounterMark, Unit, went_on

FRAME = load_frame(find_shipped("frames", "time_tags"))


class Line:
    """Both ends of a pseudo-terminal behind a name that stays."""

    def __init__(self, name: Path) -> None:
        self.name, self.far = name, -1
        self.plug()

    def plug(self) -> None:
        self.far, near = pty.openpty()
        tty.setraw(near)
        self.name.unlink(missing_ok=True)
        self.name.symlink_to(os.ttyname(near))
        os.close(near)

    def pull(self) -> None:
        if self.far >= 0:
            os.close(self.far)
        self.far = -1


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    made = Line(tmp_path / "port_a")
    yield made
    made.pull()


@pytest.fixture
def link(line: Line) -> Iterator[PortLink]:
    made = PortLink(partial(open_port, "port_a", str(line.name), 115_200, exclusive=True))
    yield made
    made.close()


def test_reading_a_pseudo_terminal(line: Line, link: PortLink) -> None:
    assert link.read(100) == b""
    os.write(line.far, bytes(range(256)))  # XON and XOFF among them
    assert link.read(1000) == bytes(range(256))
    assert link.write(b"\x11\x13") == 2
    assert os.read(line.far, 10) == b"\x11\x13"
    assert link.in_waiting == 0


def test_the_end_of_a_port_is_an_error_and_the_way_back_is_its_name(line: Line, link: PortLink) -> None:
    line.pull()
    with pytest.raises(OSError, match=r"hung up|Input/output error"):
        link.read(100)
    with pytest.raises(LinkError, match="B-RUN-003"):
        link.reopen()
    line.plug()
    link.reopen()
    os.write(line.far, b"again")
    assert link.read(100) == b"again"


def test_nobody_else_opens_the_port(line: Line, link: PortLink) -> None:
    assert descriptor_of(link) is not None
    with pytest.raises(LinkError, match="B-RUN-003"):
        open_port("port_a", str(line.name), 115_200, exclusive=True)


def test_flow_control_is_off_and_low_latency_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}
    modes: list[bool] = []
    port = SimpleNamespace(set_low_latency_mode=modes.append)
    monkeypatch.setattr(serial, "serial_for_url", lambda url, **options: asked.update(options, url=url) or port)
    assert open_port("a", "/dev/ttyUSB0", 115_200, exclusive=True) is port
    assert (asked["xonxoff"], asked["rtscts"], asked["dsrdtr"], asked["exclusive"]) == (False, False, False, True)
    assert modes == [True]


def usb(device: str, number: str | None) -> ListPortInfo:
    found = ListPortInfo(device)
    found.serial_number = number
    return found


def test_a_port_by_the_serial_number_of_its_adapter(line: Line, monkeypatch: pytest.MonkeyPatch) -> None:
    ports = [usb("/dev/ttyS0", None), usb(str(line.name), "FT4711"), usb("/dev/ttyUSB9", "FT4712")]
    monkeypatch.setattr(list_ports, "comports", lambda: ports)
    port: Any = open_port("port_a", "serial-number:FT4711", 115_200, exclusive=True)
    assert port.port == str(line.name)
    port.close()
    with pytest.raises(LinkError, match=r"B-RUN-003: .*FT4711, FT4712"):
        open_port("port_a", "serial-number:FT1", 115_200, exclusive=True)
    ports.append(usb("/dev/ttyUSB3", "FT4711"))
    with pytest.raises(LinkError, match="2 ports have the serial number"):
        open_port("port_a", "serial-number:FT4711", 115_200, exclusive=True)


def test_a_pseudo_terminal_counts_nothing(link: PortLink) -> None:
    assert kernel_counts(link) is None
    assert kernel_counts(SimpleNamespace()) is None


def test_the_places_in_the_kernels_structure(link: PortLink, monkeypatch: pytest.MonkeyPatch) -> None:
    """linux/serial.h: cts, dsr, rng, dcd, rx, tx, frame, overrun, parity, brk, buf_overrun, reserved[9]."""
    answer = struct.pack("20i", *range(1, 12), *[0] * 9)
    asked: list[tuple[int, int]] = []
    monkeypatch.setattr(fcntl, "ioctl", lambda fd, what, room: asked.append((what, len(room))) or answer)
    assert kernel_counts(link) == {"frame": 7, "overrun": 8, "parity": 9, "buf_overrun": 11}
    assert asked == [(0x545D, 80)]  # asm-generic/ioctls.h


@pytest.mark.parametrize(
    ("raw", "seconds", "expected"),
    [
        (1100, 1.0, True),  # exactly as the time predicts
        (1160, 1.0, True),  # late by what a busy machine is late
        (1400, 1.0, False),
        (0, 1.0, False),  # begun anew
        ((1000 + 60_000) % 65536, 600.0, True),
        ((1000 + 100 * 36_000) % 65536, 36_000.0, True),  # 55 wraps later
        ((1000 + 100 * 36_000 + 5000) % 65536, 36_000.0, False),
    ],
)
def test_whether_a_counter_went_on(raw: int, seconds: float, expected: bool) -> None:
    before, after = CounterMark(1000, 5 * NS), CounterMark(raw, 5 * NS + round(seconds * NS))
    assert went_on(before, after, 100.0, 65536) is expected


@pytest.mark.parametrize(
    ("raw", "expected"), [(1001, True), (1250, True), (1400, True), (1700, False), (900, False), (0, False)]
)
def test_a_buffer_may_hand_over_what_is_old_but_nothing_from_before(raw: int, expected: bool) -> None:
    """A tagger that was silent for 4 s begins with its oldest blocks: it was not restarted."""
    assert went_on(CounterMark(1000, 0), CounterMark(raw, 4 * NS), 100.0, 1 << 32, buffered=True) is expected


def test_without_a_rate_a_counter_proves_nothing() -> None:
    assert went_on(CounterMark(1, 0), CounterMark(30_000, NS), None, 65536)
    assert went_on(CounterMark(-1, -1), CounterMark(30_000, NS), 100.0, 65536)


def unit_step(number: int, name: str, code: int) -> Step:
    return planned("unit", number, role="port_b", name=name, command=code)


THREE_COMMANDS = [unit_step(0, "identify", 1), unit_step(1, "start", 2), unit_step(2, "stop", 3)]


@pytest.mark.parametrize(
    ("answer", "verdict"), [(b"NGU SIM-1 1.0", "same"), (b"NGU SIM-10 1.0", "other"), (b"\xff\x00", "other")]
)
def test_a_unit_that_was_never_asked_is_known_by_its_serial_number(tmp_path: Path, answer: bytes, verdict: str) -> None:
    rig = Rig(tmp_path)
    rig.steps = THREE_COMMANDS
    context = rig.context()
    context.plan.campaign["uut"] = {"serial": "SIM-1"}  # type: ignore[index]
    unit = Unit(context)
    assert unit.ask()
    definition = frame("ngu_b")
    rig.port_b._pending.append((0, definition.encode_one({"command": 1, "status": 0, "payload": answer}, "answer")))
    assert unit.verdict() == "pending"
    context.acquisition.refresh()
    assert unit.verdict() == verdict


def test_the_last_command_before_a_step_is_sent_again(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.steps = THREE_COMMANDS
    unit = Unit(rig.context())
    assert [unit.again(number) for number in (1, 2, 3)] == ["", "start", "stop"]
    rig.port_b.write = lambda sent: (_ for _ in ()).throw(OSError("gone"))  # type: ignore[method-assign]
    assert unit.again(2) == ""


class Buffer(SimpleNamespace):
    """An instrument that keeps bytes until they are read."""

    role = "tagger"
    kept = b"abcdef"
    silent = False

    def read_stream(self, most_bytes: int) -> bytes:
        if self.silent:
            raise InstrumentError("B-INST-001", "no reply", where="tagger")
        found, self.kept = self.kept[:most_bytes], self.kept[most_bytes:]
        return found


def link_of(instrument: Any) -> InstrumentLink:
    return InstrumentLink("edges", instrument)


def test_what_is_buffered_is_read_once_and_nothing_is_written_to_it() -> None:
    link = link_of(Buffer())
    assert [link.read(4), link.read(4), link.read(4)] == [b"abcd", b"ef", b""]
    with pytest.raises(OSError, match="3 bytes for an instrument"):
        link.write(b"abc")


def test_an_instrument_that_does_not_answer_is_a_port_that_is_gone_and_comes_back() -> None:
    buffer = Buffer()
    link = link_of(buffer)
    buffer.silent = True
    with pytest.raises(OSError, match="no reply"):
        link.read(4)
    buffer.silent = False
    link.reopen()
    assert link.read(4) == b"abcd"


def test_frames_that_waited_in_a_buffer_are_not_old() -> None:
    clock = VirtualClock()
    reader = LinkReader("edges", link_of(Buffer()), FRAME, clock, sink=SimpleNamespace())  # type: ignore[arg-type]
    reader.last_frame_ns = 0
    assert not is_stale(reader, to_ns(0.49))
    assert is_stale(reader, to_ns(0.51))


def test_an_instrument_without_a_buffer_b_run_007() -> None:
    with pytest.raises(InputError) as caught:
        link_of(SimpleNamespace(role="supply"))
    assert (caught.value.code, "supply" in caught.value.message) == ("B-RUN-007", True)


@pytest.mark.parametrize(
    ("link", "due"),
    [
        ("{frame: time_tags}", "'baud', or the 'instrument'"),
        ("{frame: time_tags, instrument: tagger, baud: 9600}", "no 'baud'"),
        ("{frame: time_tags, instrument: taggr}", "'taggr', which is no"),
    ],
)
def test_a_link_has_one_source(tmp_path: Path, link: str, due: str) -> None:
    shipped = find_shipped("stations", "rlg_bench_sim").read_text(encoding="utf-8")
    path = tmp_path / "rlg_bench_sim.yaml"
    path.write_text(shipped.replace("{frame: time_tags, instrument: tagger}", link))
    with pytest.raises(InputErrors, match=due):
        load_station(path)
