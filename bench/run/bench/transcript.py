"""Instrument traffic before its session exists, and the name of a session's folder."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from bench.model.ports import SessionSink
from bench.record import RecordError


class HeldTranscript:
    """Holds commands and replies until a session is attached, then hands them on as they come.

    It never raises: a disk that is full must not keep a command from an instrument, least of all the one that makes
    it safe. The recorder reports the fault by itself at its next tick. ``heard`` are called with every line of the
    session, ``earlier`` are those from before it.
    """

    def __init__(self) -> None:
        self._held: list[tuple[str, str, str, int]] = []
        self._sink: SessionSink | None = None
        self.earlier: tuple[tuple[str, str, str, int], ...] = ()
        self.heard: list[Callable[[str, str, str, int], None]] = []
        self.on_traffic: Callable[[], None] = lambda: None  # a sign of life of whoever talks

    def __call__(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        self.on_traffic()
        if self._sink is None:
            self._held.append((role, direction, text, t_mono_ns))
        else:
            with suppress(RecordError):
                self._sink.command(role, direction, text, t_mono_ns)
            for hear in self.heard:
                hear(role, direction, text, t_mono_ns)

    def attach(self, sink: SessionSink) -> None:
        """Write what was held and pass everything on from now on."""
        for line in self._held:
            sink.command(*line)
        self.earlier = tuple(self._held)
        self._held.clear()
        self._sink = sink


def new_folder(out: Path, name: str) -> Path:
    """A folder that does not exist yet; a taken name gets the suffix -2, -3 ..., which appears in no file."""
    folder = out / name
    suffix = 2
    while folder.exists():
        folder = out / f"{name}-{suffix}"
        suffix += 1
    return folder
