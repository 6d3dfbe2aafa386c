"""The messages of a finished session in the order of time, as a replay needs them."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.model.clock import NS
from bench.record import Message, SessionReader, layout

_TOPICS = frozenset({layout.EVENT, layout.INSTRUMENT, layout.CLOCK})


@dataclass(frozen=True)
class Recording:
    """What a session says besides the bytes of its links.

    ``t_utc_s``: time of each message, never going backwards; UTC of the start of its part plus bench time elapsed.
    ``last_utc_s``: of the last message.
    """

    folder: Path
    manifest: dict[str, Any]
    texts: dict[str, str]
    t_utc_s: list[float]
    messages: list[Message]

    @property
    def first_utc_s(self) -> float:
        """Time of the first message; 0 if there is none."""
        return self.t_utc_s[0] if self.t_utc_s else 0.0

    @property
    def last_utc_s(self) -> float:
        """Time of the last message; 0 if there is none."""
        return self.t_utc_s[-1] if self.t_utc_s else 0.0

    def until(self, t_utc_s: float) -> int:
        """Return how many messages are not later than a time."""
        return bisect_right(self.t_utc_s, t_utc_s)


def read_recording(folder: Path) -> Recording:
    """Read the events and the traffic of the instruments of a session, and nothing else.

    Raises: InputError B-REC-010, SessionDamaged B-REC-012, B-REC-014.
    """
    reader = SessionReader(folder)
    manifest, texts = reader.manifest, reader.texts
    times: list[float] = []
    messages: list[Message] = []
    part: list[Message] = []
    offset_ns: int | None = None
    for message in reader.select(_TOPICS):
        if message.topic == layout.CLOCK:
            if offset_ns is None:
                pair = message.document()
                offset_ns = int(pair["t_utc_ns"]) - int(pair["t_mono_ns"])
            continue
        if message.topic == layout.EVENT and message.event()[0] == "resume":
            _place(part, offset_ns, times, messages)
            part, offset_ns = [], None
        part.append(message)
    _place(part, offset_ns, times, messages)
    return Recording(folder, manifest, texts, times, messages)


def _place(part: list[Message], offset_ns: int | None, times: list[float], messages: list[Message]) -> None:
    for message in part:
        t_utc_s = (message.t_ns + (offset_ns or 0)) / NS
        times.append(max(t_utc_s, times[-1]) if times else t_utc_s)
        messages.append(message)
