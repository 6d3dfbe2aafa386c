"""A recorded link serves its bytes again at their times."""

from __future__ import annotations

from pathlib import Path

from record_sample import MANIFEST, NS, TEXTS, write_sample

from bench.model.clock import VirtualClock
from bench.model.ports import ByteLink
from bench.record import SessionWriter
from bench.replay import RecordedLink


def test_bytes_come_at_their_times(tmp_path: Path) -> None:
    given = write_sample(tmp_path / "s", seconds=5)
    clock = VirtualClock()
    clock.sleep(100.0)
    link = RecordedLink(tmp_path / "s", "port_a", clock)
    port: ByteLink = link
    for second, chunk in enumerate(given, 1):
        clock.sleep_until_ns((100 + second) * NS - 1)
        assert port.in_waiting == 0
        clock.sleep_until_ns((100 + second) * NS)
        assert port.in_waiting == len(chunk)
        assert port.read(len(chunk)) == chunk
    assert link.exhausted


def test_any_size_of_read_gives_the_same_bytes(tmp_path: Path) -> None:
    given = b"".join(write_sample(tmp_path / "s", seconds=4))
    clock = VirtualClock()
    link = RecordedLink(tmp_path / "s", "port_a", clock)
    assert link.read(10) == b""
    clock.sleep(2.5)
    early = link.read(7) + link.read(5000)
    assert early == given[:1200]
    clock.sleep(10.0)
    late = b""
    while link.in_waiting:
        late += link.read(13)
    assert early + late == given
    assert link.write(b"command") == 7


def test_a_closed_link_is_silent(tmp_path: Path) -> None:
    write_sample(tmp_path / "s", seconds=4)
    clock = VirtualClock()
    link = RecordedLink(tmp_path / "s", "port_a", clock)
    clock.sleep(2.0)
    assert link.in_waiting > 0
    link.close()
    assert (link.in_waiting, link.read(5), link.exhausted) == (0, b"", True)


def test_a_link_that_received_nothing(tmp_path: Path) -> None:
    SessionWriter.create(tmp_path, MANIFEST, TEXTS, t_mono_ns=50).close("done")
    link = RecordedLink(tmp_path, "port_b", VirtualClock())
    assert (link.in_waiting, link.exhausted) == (0, True)
