"""A link that is read from an instrument: its errors are those of a port that is gone."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bench.frame import load_frame
from bench.model.clock import VirtualClock, to_ns
from bench.model.errors import InputError, InputErrors, InstrumentError
from bench.model.shipped import find_shipped
from bench.plan import load_station
from bench.run.links.instrument import InstrumentLink
from bench.run.links.reader import LinkReader
from bench.run.links.status import is_stale

FRAME = load_frame(find_shipped("frames", "time_tags"))


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


def test_what_is_buffered_is_read_once() -> None:
    link = link_of(Buffer())
    assert [link.read(4), link.read(4), link.read(4)] == [b"abcd", b"ef", b""]


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


def test_nothing_is_written_to_a_buffer() -> None:
    with pytest.raises(OSError, match="3 bytes for an instrument"):
        link_of(Buffer()).write(b"abc")


def test_an_instrument_without_a_buffer_b_run_007() -> None:
    with pytest.raises(InputError) as caught:
        link_of(SimpleNamespace(role="supply"))
    assert (caught.value.code, "supply" in caught.value.message) == ("B-RUN-007", True)


@pytest.mark.parametrize(
    ("old", "new", "due"),
    [
        ("{frame: time_tags, instrument: tagger}", "{frame: time_tags}", "a link has a 'baud', or the 'instrument'"),
        ("{frame: time_tags, instrument: tagger}", "{frame: time_tags, instrument: tagger, baud: 9600}", "no 'baud'"),
        ("{frame: time_tags, instrument: tagger}", "{frame: time_tags, instrument: taggr}", "'taggr', which is no"),
    ],
)
def test_a_link_has_one_source(tmp_path: Path, old: str, new: str, due: str) -> None:
    path = tmp_path / "rlg_bench_sim.yaml"
    path.write_text(find_shipped("stations", "rlg_bench_sim").read_text(encoding="utf-8").replace(old, new))
    with pytest.raises(InputErrors) as caught:
        load_station(path)
    assert due in str(caught.value)
