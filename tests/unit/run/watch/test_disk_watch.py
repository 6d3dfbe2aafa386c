"""A disk that is late holds the run until it is in time again; nothing else of the run waits for it."""

from __future__ import annotations

import threading
from contextlib import AbstractContextManager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hold_rig import HoldRig, sound

from bench.model.clock import WallClock
from bench.record import SessionReader, SessionWriter
from bench.record import writer as writer_module
from bench.record.files import AppendFile, OsFiles
from bench.run.context import RunContext
from bench.run.guard.health import LINKS, SEQUENCER, WRITER, Health
from bench.run.guard.start import LONGEST_SILENCE_S
from bench.run.stop import StopSwitch
from bench.run.watch import disk
from bench.run.watch.disk import LATE_S, LIMIT_S, disk_watch


class SlowDisk:
    """Each fsync that begins from ``from_s`` to ``to_s`` of the bench clock takes ``seconds``."""

    def __init__(self, rig: HoldRig, seconds: float, from_s: float, to_s: float) -> None:
        self._clock, self._seconds, self._from_s, self._to_s = rig.clock, seconds, from_s, to_s

    def _sync(self) -> None:
        now_s = self._clock.now_ns() / 1e9
        if self._from_s <= now_s < self._to_s:
            self._clock.sleep(self._seconds)

    def beside(self, context: RunContext) -> AbstractContextManager[object]:
        return disk_watch(context, {"session": self._sync, "step journal": self._sync})


@pytest.mark.parametrize(("seconds", "holds"), [(2.4, 0), (8.0, 1), (600.0, 1)])
def test_two_files_that_are_late_together_hold_the_run_until_the_disk_is_in_time(
    tmp_path: Path, seconds: float, holds: int
) -> None:
    """8 s each: none is slow enough for a limit of 15 s, both together are."""
    rig = HoldRig(tmp_path, 3)
    slow = SlowDisk(rig, seconds, 7.5, 8.5 + seconds)
    outcome = rig.run_beside(slow.beside)
    assert outcome.error is None
    sound(rig, 3)
    held = rig.events("hold")
    assert [hold["by"] for hold in held] == ["disk"] * holds
    if holds:
        assert "waiting for the session since 00:00:08 UTC" in held[0]["reason"]
        assert rig.events("armed") == [{"step": held[0]["step"], "by": "somebody"}]
    assert rig.stop.holds.reasons == {}


def test_a_disk_that_is_slow_each_time_ends_the_run_safely_after_half_an_hour(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 2)
    outcome = rig.run_beside(SlowDisk(rig, 8.0, 7.5, 1e9).beside)
    assert outcome.error.code == "B-RUN-070"
    assert "an fsync is not over after 5 s" in outcome.error.message
    assert len(rig.events("hold")) == 1  # not let go and held again with each round
    end_s = rig.called("source.make_safe")[-1]
    assert 7.5 + LATE_S + LIMIT_S <= end_s <= 7.5 + LATE_S + LIMIT_S + 60.0


def test_the_end_of_a_run_is_not_held_up(tmp_path: Path) -> None:
    rig = HoldRig(tmp_path, 1)
    rig.step("settle", duration_s=30.0, bus_s=0.0, phase="finally")
    assert rig.run_beside(SlowDisk(rig, 8.0, 15.5, 24.5).beside).error is None
    assert rig.events("hold") == []


class HangingFiles(OsFiles):
    """Every fsync waits while the gate is shut."""

    def __init__(self) -> None:
        self.gate = threading.Event()

    def create(self, path: Path) -> AppendFile:
        file = super().create(path)
        return SimpleNamespace(write=file.write, truncate=file.truncate, close=file.close, sync=self._sync)

    def _sync(self) -> None:
        assert self.gate.wait(30.0)


@pytest.mark.waits
def test_a_hanging_fsync_takes_no_memory_and_no_sign_of_life(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In real time, with the limits a tenth of a second: what comes meanwhile goes on into the file."""
    for name in ("SYNC_S", "LOOK_S", "LATE_S"):
        monkeypatch.setattr(disk, name, 0.1)
    monkeypatch.setattr(writer_module, "HELD_BYTES", 20_000)
    clock, stop, files = WallClock(), StopSwitch(), HangingFiles()
    writer = SessionWriter.create(tmp_path / "s", {}, {}, t_mono_ns=clock.now_ns(), files=files)
    context: Any = SimpleNamespace(clock=clock, stop=stop, health=Health(clock), event=lambda event: None)
    with disk_watch(context, {"session": writer.sync}):
        for turn in range(100):
            writer.raw("port_a", "rx", clock.now_ns(), bytes(10_000))
            writer.tick(clock.now_ns())
            assert writer._buffer.size < 20_000
            clock.sleep(0.005 if turn else 0.5)
        assert list(stop.holds.reasons) == ["disk"]
        assert context.health.silence_s()[WRITER] < 0.4  # systemd's watchdog is fed on
        files.gate.set()
        for _ in range(100):
            if not stop.holds.reasons:
                break
            clock.sleep(0.05)
        assert stop.holds.reasons == {}
    assert stop.fault is None
    writer.close("done")
    payloads = [message.payload for message in SessionReader(tmp_path / "s").select(frozenset({"/link/port_a/rx"}))]
    assert [len(payload) for payload in payloads] == [10_000] * 100


def test_the_guard_ends_no_run_that_waits_for_a_disk() -> None:
    assert set(LONGEST_SILENCE_S) == {SEQUENCER, LINKS}
