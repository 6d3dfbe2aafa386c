"""The trend beside a run: every frame and temperature becomes part of a row a second, which history is drawn from.

The run never waits for it and never fails because of it. Whatever goes wrong, it is said once, the trend is given up,
and it can be made again from the recording.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from bench.frame import BENCH, LinkBatch
from bench.model.errors import BenchError
from bench.model.events import Event
from bench.plan import Step
from bench.record import FOLDER, HEAD, BenchRows, Files, LinkReduction, TrendWriter, read_head, read_journal, sources_of
from bench.run.context import RunContext
from bench.run.feed.scenery import signals_of
from bench.run.observers import Observer

WRITE_S = 1.0
VIRTUAL_FRAMES = 12_000  # of a link, reduced at once: two minutes
MOST_FRAMES = 100_000  # kept while the disk holds the writer up: 6 MB, a quarter of an hour

Taken = list[Any]


class TrendRecorder(Observer):
    """Hears batches of the links, events and steps, and writes the trend of this part of the session.

    Under the wall clock a thread of its own writes (``pump``), so that a slow disk holds nobody up.
    """

    def __init__(self, context: RunContext, files: Files | None = None) -> None:
        self._context = context
        self._lock = threading.Lock()
        self._bench = BenchRows()
        self._failed: Exception | None = None
        frames, _, signals = signals_of(context)
        sources = sources_of(signals, frames)
        clock = context.clock
        self._writer: TrendWriter | None = TrendWriter(context.folder, sources, clock.now_ns(), clock.utc_ns(), files)
        self._links = {
            name: LinkReduction(source, frames[name]) for name, source in self._writer.sources.items() if name in frames
        }

    def batch(self, link: str, batch: LinkBatch) -> None:
        """Frames of a link were decoded; they are only queued here."""
        if link in self._links:
            self._heard(lambda writer: self._links[link].push(batch))

    def event(self, event: Event, t_mono_ns: int) -> None:
        self._heard(lambda writer: writer.add(BENCH, self._bench.event(event, t_mono_ns + writer.offset_ns)))

    def step(self, step: Step, at_s: float) -> None:
        asked = step.set_point
        if asked is not None:
            degC = asked.temperature_degC
            self._heard(lambda writer: writer.add(BENCH, self._bench.setpoint(self._utc_ns(writer), degC)))

    def pump(self) -> None:
        """Write what is complete; only this and ``close`` touch the disk."""
        writer = self._writer
        if writer is None:
            return
        try:
            with self._lock:
                taken = self._due(writer)
            writer.hand_over(taken)
        except Exception as error:  # whatever goes wrong with the trend is no concern of the run
            self._give_up(error)

    def close(self) -> None:
        """Write everything: the run is over."""
        writer = self._writer
        if writer is None:
            return
        try:
            with self._lock:
                self._end(writer)
            self._writer = None
        except Exception as error:
            self._give_up(error)

    def _end(self, writer: TrendWriter) -> None:
        self._reduce(writer)
        writer.add(BENCH, self._bench.end(self._utc_ns(writer)))
        writer.close()

    def _due(self, writer: TrendWriter) -> Taken:
        self._reduce(writer)
        writer.add(BENCH, self._bench.advance(self._utc_ns(writer)))
        return writer.take()

    def _reduce(self, writer: TrendWriter) -> None:
        if self._failed is not None:
            raise self._failed
        for name, link in self._links.items():
            writer.add(name, link.rows(writer.offset_ns))

    def _utc_ns(self, writer: TrendWriter) -> int:
        return self._context.clock.now_ns() + writer.offset_ns

    def _heard(self, act: Callable[[TrendWriter], None]) -> None:
        """Take what the run says; nobody waits for a disk here, unless the clock is virtual."""
        writer = self._writer
        if writer is None or self._failed is not None:
            return
        waiting = 0
        with self._lock:
            try:
                act(writer)
                waiting = max((link.frames for link in self._links.values()), default=0)
                if waiting > MOST_FRAMES:
                    raise OSError(28, "the disk takes nothing")
            except Exception as error:
                self._failed = error
        if self._context.clock.virtual and waiting > VIRTUAL_FRAMES:
            self.pump()

    def _give_up(self, error: Exception) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.give_up()
            given_up(self._context, error)


def given_up(context: RunContext, error: Exception) -> None:
    """Say that there is no trend of this run; one that lacks a part must not pass for one that is whole."""
    with suppress(OSError):
        (context.folder / FOLDER / HEAD).unlink(missing_ok=True)
    why = error.strerror or str(error) if isinstance(error, OSError) else f"{type(error).__name__}: {error}"
    context.message(f"no trend is written any more ({why}); the recording goes on, history is made from it")


@contextmanager
def trend_recorder(context: RunContext, files: Files | None = None) -> Iterator[TrendRecorder | None]:
    """Write the trend while the run goes on; None if it cannot even begin, which is said and no reason to stop."""
    recorder = _begun(context, files)
    if recorder is None:
        yield None
        return
    context.observers.add(recorder)
    periodic = None if context.clock.virtual else context.clock.every(WRITE_S, recorder.pump)
    try:
        yield recorder
    finally:
        if periodic is not None:
            periodic.cancel()
        recorder.close()


def _begun(context: RunContext, files: Files | None) -> TrendRecorder | None:
    if read_journal(context.folder).entries and read_head(context.folder / FOLDER) is None:
        context.message("the earlier part of this session has no trend; history is made from the recording")
        return None
    try:
        return TrendRecorder(context, files)
    except (OSError, BenchError) as error:
        given_up(context, error)
        return None
