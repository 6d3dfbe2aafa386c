"""Damage to segments and power cuts: no exception, no invented message, nothing lost without being said.

One flipped bit anywhere is noticed and costs one chunk at most, with exit status 5; the rest still fits. The model of a
power cut is that of SQLite's crash tests: the recorder writes each second and syncs; the cut comes at any write.
Everything up to the last sync is on the disk, each 512-byte sector behind it is kept, zeroed, random or missing with
all that follows, and the file may end in zeros.
"""

from pathlib import Path

import numpy as np
import pytest
from record_sample import MANIFEST, NS, TEXTS, write_sample

from bench.commands.fit import fit
from bench.commands.recover import recover
from bench.model.errors import ExitStatus
from bench.model.events import Resume
from bench.record import (
    Journal,
    Message,
    SessionReader,
    SessionWriter,
    Walk,
    read_journal,
    recover_session,
    resume_session,
)
from bench.record.journal import JOURNAL_NAME
from bench.record.layout import AppendFile, OsFiles

SEED = 5
NAME = "session.0001.mcap"


def good(folder: Path) -> list[Message]:
    return read(folder)[0]


def chunks(content: bytes) -> dict[int, int]:
    """Chunk of each running number."""
    found: dict[int, int] = {}
    walk = Walk(None)
    spans = walk._begin(NAME, content, None)
    for index, span in enumerate(spans.spans()):
        for message in walk._messages(span):
            found[message.sequence] = index
    return found


@pytest.mark.parametrize(("flips", "fits"), [(30, 2), pytest.param(3000, 300, marks=pytest.mark.sweep)])
def test_flipped_bits(golden: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], flips: int, fits: int) -> None:
    seed, folder = SEED + (flips > 30), tmp_path
    rng = np.random.default_rng(seed)
    content = (golden / NAME).read_bytes()
    whole, chunk = good(golden), chunks(content)
    lost_most = 0
    for number in range(flips):
        at, bit = int(rng.integers(0, len(content))), int(rng.integers(0, 8))
        place = f"seed {seed}, flip {number}: byte {at}, bit {bit}"
        flipped = bytearray(content)
        flipped[at] ^= 1 << bit
        (folder / NAME).write_bytes(flipped)
        got = good(folder)
        lost = set(whole) - set(got)
        assert set(got) <= set(whole), f"{place}: something was invented"
        assert len({chunk[message.sequence] for message in lost}) <= 1, f"{place}: more than one chunk is lost"
        lost_most = max(lost_most, len(lost))
        assert recover_session(folder).damaged, f"{place}: not noticed"
        if number < fits:
            assert fit(folder, None, as_json=False) == ExitStatus.SESSION_DAMAGED, place
            said = capsys.readouterr().out
            assert "damaged:" in said, place
            assert "scale_factor of NGU" in said, place
            assert recover(folder, None, as_json=False) == ExitStatus.SESSION_DAMAGED, place
            capsys.readouterr()
    with capsys.disabled():
        print(f"seed {seed}: {flips} flips noticed, at most {lost_most} of {len(whole)} messages lost, {fits} fitted")


@pytest.mark.parametrize("at", [0, 3, 40, 200, 2000])
def test_a_flip_in_the_head_costs_neither_manifest_nor_plan(golden: Path, tmp_path: Path, at: int) -> None:
    """The chunk with manifest and texts is the first; the second holds them again."""
    content = bytearray((golden / NAME).read_bytes())
    content[at] ^= 4
    (tmp_path / NAME).write_bytes(content)
    damaged, whole = SessionReader(tmp_path), SessionReader(golden)
    assert damaged.damage
    assert damaged.manifest == whole.manifest
    assert damaged.texts == whole.texts


def read(folder: Path) -> tuple[list[Message], SessionReader]:
    reader = SessionReader(folder)
    return [message for message in reader.messages() if message.topic != "/chain"], reader


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """One to four faults: flipped bits, a wiped, removed, repeated or inserted stretch, a cut end."""
    work = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        at = int(rng.integers(0, len(work)))
        size = int(rng.integers(1, 600))
        kind = int(rng.integers(0, 6))
        if kind == 0:
            work[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            work[at : at + size] = bytes(len(work[at : at + size]))
        elif kind == 2:
            del work[at : at + size]
        elif kind == 3:
            work[at:at] = work[max(0, at - size) : at]
        elif kind == 4:
            work[at:at] = rng.bytes(size)
        else:
            del work[at:]
        if not work:
            break
    return bytes(work)


@pytest.mark.parametrize("rounds", [400, pytest.param(20_000, marks=pytest.mark.sweep)])
def test_random_damage(tmp_path: Path, rounds: int) -> None:
    seed, folder = SEED + (rounds > 400), tmp_path
    rng = np.random.default_rng(seed)
    write_sample(folder / "whole", seconds=15)
    whole, _ = read(folder / "whole")
    content = (folder / "whole" / NAME).read_bytes()
    (folder / "bad").mkdir()
    for number in range(rounds):
        place = f"seed {seed}, round {number}"
        (folder / "bad" / NAME).write_bytes(damaged(content, rng))
        got, reader = read(folder / "bad")
        assert set(got) <= set(whole), place
        if got != whole:
            assert reader.damage or reader.unfinished, place
            missing = sum(item.lost or 0 for item in reader.damage)
            assert reader.unfinished or missing >= len(whole) - len(set(got)) or got[-1] != whole[-1], place
        recover_session(folder / "bad")


def test_every_flipped_bit_is_noticed(tmp_path: Path) -> None:
    """Each byte of a finished segment in turn, one bit of it flipped."""
    rng = np.random.default_rng(SEED)
    write_sample(tmp_path / "s", seconds=1)
    whole, _ = read(tmp_path / "s")
    path = tmp_path / "s" / NAME
    content = path.read_bytes()
    silent = []
    chunk = chunks(content)
    for at in range(len(content)):
        flipped = bytearray(content)
        flipped[at] ^= 1 << int(rng.integers(0, 8))
        path.write_bytes(flipped)
        got, reader = read(tmp_path / "s")
        assert set(got) <= set(whole)
        assert len({chunk[message.sequence] for message in set(whole) - set(got)}) <= 1, f"seed {SEED}, byte {at}"
        if not reader.damage and not reader.unfinished:
            silent.append(at)
    assert silent == [], f"seed {SEED}, of {len(content)} bytes"


CUT_SEED = 2024
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


@pytest.mark.parametrize("tails", [60, pytest.param(3000, marks=pytest.mark.sweep)])
def test_power_cut(tmp_path: Path, tails: int) -> None:
    rng = np.random.default_rng(CUT_SEED)
    states = recorded(tmp_path / "whole", rng)
    content = (tmp_path / "whole" / NAME).read_bytes()
    lines = (tmp_path / "whole" / JOURNAL_NAME).read_bytes()
    whole, steps = good(tmp_path / "whole"), read_journal(tmp_path / "whole").entries
    cut = tmp_path / "cut"
    cut.mkdir()
    worst_s, kept = 0.0, 0
    for number in range(tails):
        place = f"seed {CUT_SEED}, tail {number}"
        size, synced = states[NAME][int(rng.integers(2, len(states[NAME])))]
        (cut / NAME).write_bytes(content[:synced])
        safe = good(cut)
        (cut / NAME).write_bytes(after_the_cut(content, size, synced, rng))
        got = good(cut)
        assert got[: len(safe)] == safe, f"{place}: something synced is lost"
        assert set(got) <= set(whole), f"{place}: a phantom"
        (cut / NAME).write_bytes(content[:size])
        written_ns = good(cut)[-1].t_ns
        worst_s = max(worst_s, (written_ns - (got[-1].t_ns if got else 0)) / NS)
        kept += len(got) > len(safe)
        for _ in range(JOURNALS_EACH):
            size, synced = states[JOURNAL_NAME][int(rng.integers(0, len(states[JOURNAL_NAME])))]
            (cut / JOURNAL_NAME).write_bytes(after_the_cut(lines, size, synced, rng))
            done = read_journal(cut).entries
            assert done == steps[: len(done)], f"{place}: a phantom step"
            assert len(done) >= lines[:synced].count(b"\n"), f"{place}: a synced step is lost"
    print(f"seed {CUT_SEED}: of {tails} tails at most {worst_s:g} s lost, {kept} held more than was synced, 0 phantoms")
    assert worst_s <= COMMIT_S


def test_after_a_power_cut_the_session_goes_on_in_a_new_segment(tmp_path: Path) -> None:
    rng = np.random.default_rng(CUT_SEED)
    states = recorded(tmp_path / "s", rng)["session.0001.mcap"]
    path = tmp_path / "s" / "session.0001.mcap"
    size, synced = states[len(states) // 2]
    torn = after_the_cut(path.read_bytes(), size, min(synced, size - 2000), rng)
    path.write_bytes(torn)
    before = good(tmp_path / "s")
    again = resume_session(tmp_path / "s", Resume(reason="power cut"), t_mono_ns=0)
    again.raw("port_a", "rx", NS, b"more")
    sha256 = again.close("done")
    assert path.read_bytes() == torn, "a segment that exists is never touched"
    reader = SessionReader(tmp_path / "s")
    assert (reader.damage, reader.unfinished, reader.sha256) == ([], ["session.0001.mcap"], sha256)
    assert [(fields["reason"], fields["segment"]) for _, _, fields in reader.events("resume")] == [("power cut", 2)]
    assert good(tmp_path / "s")[: len(before)] == before
    assert [message.payload for message in good(tmp_path / "s") if message.topic == "/link/port_a/rx"][-1] == b"more"
