"""A power cut: what was synced is there, what was not is kept, dropped or garbled by sectors; no record is invented.

The model of SQLite's crash tests: the recorder writes each second and syncs; the cut comes at any write. Everything
up to the last sync is on the disk, each 512-byte sector behind it is kept, zeroed, random or missing with all that
follows, and the file may end in zeros.
"""

from pathlib import Path

import numpy as np
import pytest
from record_sample import MANIFEST, NS, TEXTS

from bench.model.events import Resume
from bench.record import Journal, Message, SessionReader, SessionWriter, read_journal, resume_session
from bench.record.journal import JOURNAL_NAME
from bench.record.layout import AppendFile, OsFiles

SEED = 2024
SECONDS = 40
SECTOR = 512
COMMIT_S = 1.0
JOURNALS_EACH = 10  # cuts of the journal for each of the session


class Watched:
    """Notes the size of a file after each write, and how much of it was synced then."""

    def __init__(self, inner: AppendFile, states: list[tuple[int, int]]) -> None:
        self._inner, self._states, self._size, self._synced = inner, states, 0, 0

    def write(self, chunk: bytes) -> int:
        self._size += len(chunk)
        self._states.append((self._size, self._synced))
        return self._inner.write(chunk)

    def truncate(self, size: int) -> None:
        raise AssertionError("nothing fails here")

    def sync(self) -> None:
        self._inner.sync()
        self._synced = self._size
        self._states.append((self._size, self._synced))

    def close(self) -> None:
        self._inner.close()


class WatchedFiles(OsFiles):
    def __init__(self) -> None:
        self.states: dict[str, list[tuple[int, int]]] = {}

    def create(self, path: Path) -> AppendFile:
        return Watched(super().create(path), self.states.setdefault(path.name, []))

    def append(self, path: Path) -> AppendFile:
        return Watched(super().append(path), self.states.setdefault(path.name, []))


def recorded(folder: Path, rng: np.random.Generator) -> dict[str, list[tuple[int, int]]]:
    """A run that records each second and syncs each second, session and journal; how its files grew."""
    files = WatchedFiles()
    writer = SessionWriter.create(folder, MANIFEST, TEXTS, t_mono_ns=0, files=files)
    journal = Journal(folder, files)
    for second in range(1, SECONDS + 1):
        t_ns = second * NS
        writer.raw("port_a", "rx", t_ns, rng.bytes(int(rng.integers(100, 6400))))
        writer.event("record", t_ns, {"number": second})
        writer.tick(t_ns)
        journal.step(second, "campaign", t_ns, {"second": second}, {"calibrator.output": {"current": 1.0}})
        writer.sync()
        journal.sync()
    journal.close()
    return files.states


def after_the_cut(content: bytes, size: int, synced: int, rng: np.random.Generator) -> bytes:
    """What is on the disk of ``size`` written bytes, ``synced`` of them safe."""
    found = bytearray(content[:size])
    for start in range(synced, size, SECTOR):
        sector = slice(start, min(start + SECTOR, size))
        kind = max(0, int(rng.integers(0, 12)) - 8)  # three of four are kept
        if kind == 1:
            found[sector] = bytes(sector.stop - sector.start)
        elif kind == 2:
            found[sector] = rng.bytes(sector.stop - sector.start)
        elif kind == 3:
            del found[start:]
            break
    return bytes(found) + bytes(int(rng.integers(0, 2)) * 4096)


def good(folder: Path) -> list[Message]:
    return [message for message in SessionReader(folder).messages() if message.topic != "/chain"]


def check(folder: Path, tails: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    states = recorded(folder / "whole", rng)
    name = "session.0001.mcap"
    content = (folder / "whole" / name).read_bytes()
    lines = (folder / "whole" / JOURNAL_NAME).read_bytes()
    whole, steps = good(folder / "whole"), read_journal(folder / "whole").entries
    cut = folder / "cut"
    cut.mkdir()
    worst_s, kept = 0.0, 0
    for number in range(tails):
        place = f"seed {seed}, tail {number}"
        size, synced = states[name][int(rng.integers(2, len(states[name])))]
        (cut / name).write_bytes(content[:synced])
        safe = good(cut)
        (cut / name).write_bytes(after_the_cut(content, size, synced, rng))
        got = good(cut)
        assert got[: len(safe)] == safe, f"{place}: something synced is lost"
        assert set(got) <= set(whole), f"{place}: a phantom"
        (cut / name).write_bytes(content[:size])
        written_ns = good(cut)[-1].t_ns
        worst_s = max(worst_s, (written_ns - (got[-1].t_ns if got else 0)) / NS)
        kept += len(got) > len(safe)
        for _ in range(JOURNALS_EACH):
            size, synced = states[JOURNAL_NAME][int(rng.integers(0, len(states[JOURNAL_NAME])))]
            (cut / JOURNAL_NAME).write_bytes(after_the_cut(lines, size, synced, rng))
            done = read_journal(cut).entries
            assert done == steps[: len(done)], f"{place}: a phantom step"
            assert len(done) >= lines[:synced].count(b"\n"), f"{place}: a synced step is lost"
    print(f"seed {seed}: {tails} tails, at most {worst_s:g} s lost, {kept} tails held more than was synced, 0 phantoms")
    assert worst_s <= COMMIT_S


@pytest.mark.parametrize("tails", [60, pytest.param(3000, marks=pytest.mark.sweep)])
def test_power_cut(tmp_path: Path, tails: int) -> None:
    check(tmp_path, tails, SEED)


def test_after_a_power_cut_the_session_goes_on_in_a_new_segment(tmp_path: Path) -> None:
    rng = np.random.default_rng(SEED)
    states = recorded(tmp_path / "s", rng)["session.0001.mcap"]
    path = tmp_path / "s" / "session.0001.mcap"
    size, synced = states[len(states) // 2]
    torn = after_the_cut(path.read_bytes(), size, min(synced, size - 2000), rng)
    path.write_bytes(torn)
    before = good(tmp_path / "s")
    again = resume_session(tmp_path / "s", Resume(reason="power cut"), t_mono_ns=0)
    again.raw("port_a", "rx", NS, b"more")
    again.close("done")
    assert path.read_bytes() == torn, "a segment that exists is never touched"
    assert good(tmp_path / "s")[: len(before)] == before
    assert [message.payload for message in good(tmp_path / "s") if message.topic == "/link/port_a/rx"][-1] == b"more"
