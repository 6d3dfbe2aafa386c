"""Instrument traffic before its session exists, and the name of a session's folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from bench.run.observers import Observers


class HeldTranscript:
    """Holds commands and replies until a session is there, then hands them on as they come.

    ``earlier`` are those from before the session.
    """

    def __init__(self) -> None:
        self._held: list[tuple[str, str, str, int]] = []
        self._observers: Observers | None = None
        self.earlier: tuple[tuple[str, str, str, int], ...] = ()
        self.on_traffic: Callable[[str], None] = lambda at: None  # a sign of life of whoever talks, and of what to

    def __call__(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        self.on_traffic(f"{role} {text}")
        if self._observers is None:
            self._held.append((role, direction, text, t_mono_ns))
        else:
            self._observers.traffic(role, direction, text, t_mono_ns)

    def attach(self, observers: Observers) -> None:
        """Tell what was held, and everything from now on."""
        self._held.sort(key=lambda line: line[3])  # instruments of different buses were asked side by side
        for line in self._held:
            observers.traffic(*line)
        self.earlier = tuple(self._held)
        self._held.clear()
        self._observers = observers


def new_folder(out: Path, name: str) -> Path:
    """Return a folder that does not exist yet; a taken name gets the suffix -2, -3 ..., which appears in no file."""
    folder = out / name
    suffix = 2
    while folder.exists():
        folder = out / f"{name}-{suffix}"
        suffix += 1
    return folder
