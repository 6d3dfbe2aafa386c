"""The trend beside a run: it changes nothing, is the same for the same seed, and may fail."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from trend_sample import Heard, run_short

from bench.model.errors import InputError
from bench.record import SessionReader
from bench.record.files import AppendFile, OsFiles
from bench.record.trend_reader import TrendReader
from bench.record.trend_rows import FOLDER
from bench.replay.build_trend import build_trend, main
from bench.replay.history import history, needs_build, raw_window, trend_place
from bench.run.context import RunContext
from bench.run.watch.trend import trend_recorder

GYROS = [f"port_a.npp-ppp[{channel}]" for channel in range(1, 7)]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Heard]:
    done, heard = run_short(tmp_path_factory.mktemp("trend"))
    return done.folder, heard


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def segments(folder: Path) -> dict[str, bytes]:
    return {name: content for name, content in contents(folder).items() if name.endswith(".mcap")}


def test_no_byte_of_the_recording_changes_and_the_same_seed_gives_the_same_trend(
    recorded: tuple[Path, Heard], tmp_path: Path
) -> None:
    plain, _ = run_short(tmp_path / "plain", beside=[])
    again, _ = run_short(tmp_path / "again")
    assert not (plain.folder / FOLDER).exists()
    assert segments(plain.folder) == segments(again.folder) == segments(recorded[0])
    assert contents(again.folder / FOLDER) == contents(recorded[0] / FOLDER)
    assert len(contents(again.folder / FOLDER)) == 10


def test_the_trend_made_again_from_the_recording_is_the_same(recorded: tuple[Path, Heard], tmp_path: Path) -> None:
    assert main([str(recorded[0]), str(tmp_path)]) == 0
    made, written = TrendReader(tmp_path), TrendReader(recorded[0])
    assert made.head == written.head
    for name in ("port_a.001s", "port_b.001s", "port_a.010s"):
        assert (tmp_path / FOLDER / name).read_bytes() == (recorded[0] / FOLDER / name).read_bytes()
    span = written.span_s()
    assert span is not None
    air, setpoint = (made.window([name], *span, 1000) for name in ("bench.air", "bench.setpoint"))
    assert np.nanmax(setpoint.high) == np.float32(23.3)
    assert len(air.t_utc_s) > 10


def test_single_readings_have_the_least_and_greatest_values_of_the_trend(recorded: tuple[Path, Heard]) -> None:
    folder = recorded[0]
    span = TrendReader(folder).span_s()
    assert span is not None
    raw = raw_window(folder, [*GYROS, "bench.setpoint"], span[0] + 5, span[0] + 15)
    seconds = history(folder, GYROS, span[0] + 5, span[0] + 15, 100)
    assert (raw.bucket_s, seconds.bucket_s) == (0.0, 1.0)
    widths_s = {20.0: 0.0, 22.0: 1.0}  # raw only where there is room for it
    assert {stop: history(folder, GYROS, span[0] + 1, span[0] + stop, 1000).bucket_s for stop in widths_s} == widths_s
    assert len(raw.t_utc_s) >= 1000
    for row, start in enumerate(seconds.t_utc_s[1:-1], 1):
        mine = (raw.t_utc_s > start + 1e-6) & (raw.t_utc_s <= start + 1 + 1e-6)
        assert np.nanmin(raw.low[mine][:, :6], axis=0).tolist() == seconds.low[row].tolist()
        assert np.nanmax(raw.high[mine][:, :6], axis=0).tolist() == seconds.high[row].tolist()


def test_a_segment_without_an_end_is_read_up_to_its_last_chunk(recorded: tuple[Path, Heard], tmp_path: Path) -> None:
    start = (TrendReader(recorded[0]).span_s() or (0.0, 0.0))[0]
    whole = raw_window(recorded[0], GYROS, start + 5, start + 9)
    cut = tmp_path / "cut"
    shutil.copytree(recorded[0], cut)
    content = (cut / "session.0001.mcap").read_bytes()
    (cut / "session.0001.mcap").write_bytes(content[: len(content) * 3 // 4])
    found = raw_window(cut, GYROS, start + 5, start + 9)
    assert found.to_bytes() == whole.to_bytes()
    count, width = np.frombuffer(found.to_bytes()[:8], "<u4")
    assert (count, width) == found.low.shape
    assert len(found.to_bytes()) == 16 + 8 * count + 8 * count * width


def test_a_session_without_a_trend_gets_one_in_the_cache(recorded: tuple[Path, Heard], tmp_path: Path) -> None:
    bare, cache = tmp_path / recorded[0].name, tmp_path / "cache"
    shutil.copytree(recorded[0], bare, ignore=shutil.ignore_patterns(FOLDER))
    start = (TrendReader(recorded[0]).span_s() or (0.0, 0.0))[0]
    near = raw_window(bare, GYROS, start + 5, start + 9)
    assert near.to_bytes() == raw_window(recorded[0], GYROS, start + 5, start + 9).to_bytes()
    with pytest.raises(InputError, match="B-REC-030"):
        history(bare, GYROS, start, start + 30, 100)
    window = history(bare, GYROS, start, start + 30, 100, cache)
    assert window.to_bytes() == history(recorded[0], GYROS, start, start + 30, 100).to_bytes()
    place = trend_place(bare, cache)
    assert place is not None
    assert not needs_build(bare, place)
    assert not (bare / FOLDER).exists()
    build_trend(bare, place)  # made again in its place
    assert [path.name for path in place.iterdir()] == [FOLDER]


class Full(OsFiles):
    """A disk that refuses after some writes."""

    def __init__(self, writes: int) -> None:
        self.left = writes

    def append(self, path: Path) -> AppendFile:
        disk, file = self, super().append(path)

        class Limited:
            def __getattr__(self, name: str) -> object:
                return getattr(file, name)

            def write(self, chunk: bytes) -> int:
                disk.left -= 1
                if disk.left < 0:
                    raise OSError(28, "No space left on device")
                return file.write(chunk)

        return Limited()  # type: ignore[return-value]


@pytest.mark.parametrize("writes", [0, 3])
def test_a_disk_that_refuses_costs_the_trend_and_nothing_else(
    recorded: tuple[Path, Heard], tmp_path: Path, writes: int
) -> None:
    @contextmanager
    def beside(context: RunContext) -> Iterator[None]:
        with trend_recorder(context, Full(writes)):
            yield

    done, heard = run_short(tmp_path, beside=[beside])
    assert segments(done.folder) == segments(recorded[0])
    said = [text for text in heard.said if "no trend is written" in text]
    assert len(said) == 1
    assert "No space left" in said[0]
    assert not (done.folder / FOLDER / "trend.json").exists(), "half a trend must not pass for a whole one"


@pytest.mark.parametrize(("way", "words"), [("folder", "no trend is written"), ("error", "ZeroDivisionError")])
def test_whatever_keeps_a_trend_from_being_written_is_said_and_the_run_goes_on(
    tmp_path: Path, way: str, words: str
) -> None:
    @contextmanager
    def beside(context: RunContext) -> Iterator[None]:
        if way == "folder":
            (context.folder / FOLDER).write_text("in the way")
        with trend_recorder(context) as recorder:
            assert (recorder is None) == (way == "folder")
            if recorder is not None:
                recorder._bench.advance = lambda t_utc_ns: 1 / 0  # type: ignore[method-assign,assignment,return-value]
            yield

    done, heard = run_short(tmp_path, beside=[beside])
    assert len([text for text in heard.said if words in text]) == 1
    assert SessionReader(done.folder).damage == []


def test_what_no_session_has_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(tmp_path), str(tmp_path / "out")]) == 2
    assert "B-REC-010" in capsys.readouterr().err
