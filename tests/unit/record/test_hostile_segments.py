"""Segments that lie about their sizes, and what is no segment at all: refused or read in bounded memory."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
from record_sample import ROOT, write_sample

from bench.model.errors import SessionDamaged
from bench.record import SessionReader, mapped, recover_session, scan
from bench.record import mcap_format as mcap

MOST_MB = 200
SEGMENT = "session.0001.mcap"
START = mcap.MAGIC + mcap.record(mcap.HEADER, bytes(8))
PEAK = """
import re, sys
from pathlib import Path
from bench.cli import main
sys.argv = ["bench", *sys.argv[1:]]
status = 0
try:
    main()
except SystemExit as end:
    status = end.code
high_kB = re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1]
print(int(high_kB) // 1000, status)
"""


def chunk(packed: bytes, declared: int, crc: int = 1) -> bytes:
    head = struct.pack("<QQQII", 0, 0, declared, crc, 3) + b"lz4" + struct.pack("<Q", len(packed)) + packed
    return mcap.record(mcap.CHUNK, head)


def bombs(declared: int) -> bytes:
    return START + 7 * chunk(lz4.frame.compress(bytes(256 << 20)), declared)


def unknown_channels() -> bytes:
    """Half a million messages of channels that nothing names."""
    records = b"".join(mcap.record(mcap.MESSAGE, struct.pack("<HIQQ", n % 60000, 0, 0, 0)) for n in range(100_000))
    return START + 5 * chunk(lz4.frame.compress(records), len(records), 0)


CONTENTS: dict[str, Callable[[], bytes]] = {
    "declares 256 MB and holds them": lambda: bombs(256 << 20),
    "declares 1 kB and holds 256 MB": lambda: bombs(1000),
    "declares 60 MB and holds 256 MB": lambda: bombs(60 << 20),
    "declares 4 TB": lambda: START + 7 * chunk(lz4.frame.compress(b"x" * 100), 1 << 42),
    "messages of unknown channels": unknown_channels,
    "a summary that begins in front of everything": lambda: (
        START + bytes(1000) + mcap.record(mcap.FOOTER, struct.pack("<QQI", 9, 0, 0)) + mcap.MAGIC
    ),
}


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is read from /proc")
@pytest.mark.parametrize("what", CONTENTS)
def test_what_a_segment_declares_is_no_reason_to_ask_for_memory(what: str, tmp_path: Path) -> None:
    (tmp_path / SEGMENT).write_bytes(CONTENTS[what]())
    done = subprocess.run(
        [sys.executable, "-c", PEAK, "recover", str(tmp_path)], capture_output=True, text=True, timeout=60.0,
        check=True, cwd=ROOT,
    )  # fmt: skip
    *lines, last = done.stdout.splitlines()
    peak_MB, status = map(int, last.split())
    print(f"{what}: {peak_MB} MB")
    assert peak_MB < MOST_MB
    assert status == 5
    assert len(lines) < 70
    assert any(line.startswith("damaged: ") for line in lines)


def to_link(path: Path) -> None:
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("make", [os.mkfifo, to_link, Path.mkdir], ids=["pipe", "link to a device", "folder"])
def test_what_is_no_plain_file_is_not_opened(make: Callable[[Path], None], tmp_path: Path) -> None:
    write_sample(tmp_path, 3)
    make(tmp_path / "session.0002.mcap")
    with pytest.raises(SessionDamaged) as caught:
        SessionReader(tmp_path)
    assert (caught.value.code, caught.value.where) == ("B-REC-013", str(tmp_path / "session.0002.mcap"))


def test_a_large_segment_is_read_through_a_window_with_the_same_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_sample(tmp_path / "sound", 30)
    shutil.copytree(tmp_path / "sound", tmp_path / "damaged")
    path = tmp_path / "damaged" / SEGMENT
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)
    for name, damaged in (("sound", False), ("damaged", True)):
        whole = recover_session(tmp_path / name)
        messages = list(SessionReader(tmp_path / name).messages())
        with monkeypatch.context() as small:
            small.setattr(mapped, "WHOLE_BYTES", 0)
            small.setattr(mapped, "_PIECE_BYTES", 1000)
            small.setattr(scan, "_SEARCHED_BYTES", 50)
            assert recover_session(tmp_path / name) == whole
            assert list(SessionReader(tmp_path / name).messages()) == messages
        assert whole.damaged == damaged


def test_an_empty_segment_is_no_reason_to_fail(tmp_path: Path) -> None:
    (tmp_path / SEGMENT).touch()
    survey = recover_session(tmp_path)
    assert survey.unfinished == (SEGMENT,)
    assert not survey.damaged
