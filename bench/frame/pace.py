"""How fast a definition is decoded on this machine, before a link has to be."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10

from bench.frame.definition import Engine, FrameDefinition
from bench.frame.numpy_engine import NumpyDecoder
from bench.model.clock import NS, Clock

_STREAM_BYTES = 1 << 16


@dataclass(frozen=True)
class Pace:
    """The engine, frames per second of it, and the rate of the frames (None if the definition states none)."""

    frame: str
    engine: Engine
    frames_per_s: float
    rate_Hz: float | None
    checked: bool

    def __str__(self) -> str:
        engine = {"numpy": "by numpy", "reference": "one by one"}[self.engine]
        if self.rate_Hz is None:
            fast = f"more than {_power(self.frames_per_s)} frames/s"
        elif self.frames_per_s < self.rate_Hz:
            fast = f"only {self.frames_per_s:.3g} frames/s, too slow for its {self.rate_Hz:g} Hz"
        else:
            fast = f"more than {_power(self.frames_per_s / self.rate_Hz)} times its {self.rate_Hz:g} Hz"
        return f"{self.frame} {engine}, {fast}{'' if self.checked else '; no check: a damaged frame counts as good'}"


def pace_of(definition: FrameDefinition, clock: Clock) -> Pace:
    """Decode the golden frames of a definition for some milliseconds."""
    frames = definition.golden * max(1, _STREAM_BYTES // sum(map(len, definition.golden)))
    stream = b"".join(frames)
    definition.decoder().feed(stream)  # tables are made at the first call
    decoder = definition.decoder()
    begin = clock.now_ns()
    decoder.feed(stream)
    frames_per_s = len(frames) * NS / max(1, clock.now_ns() - begin)
    engine: Engine = "numpy" if isinstance(decoder, NumpyDecoder) else "reference"
    return Pace(definition.name, engine, frames_per_s, definition.rate_Hz, definition.layout.check.size > 0)


def _power(value: float) -> str:
    """Return the power of ten below a value: more digits would be those of the moment."""
    return f"{10 ** max(0, floor(log10(value))):,}"
