"""Sources at the terminals of the meters: any source, wired by the world to an instrument's input or channel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

OfTime = Callable[[int], float]  # of bench time, nanoseconds


def _nothing(t_ns: int) -> float:
    return 0.0


@dataclass(frozen=True)
class Source:
    """A source of a voltage, a resistance or both in series, each a function of bench time, and its leads.

    ``lead_ohm``: resistance of one of the two leads that carry the current; sense leads carry none.
    """

    resistance_ohm: OfTime = _nothing
    voltage_V: OfTime = _nothing
    lead_ohm: float = 0.0

    def ohm(self, wires: int, t_ns: int) -> float:
        """Return resistance between the terminals of a meter with two or four wires: four exclude the leads."""
        return self.resistance_ohm(t_ns) + (0.0 if wires == 4 else 2.0 * self.lead_ohm)


class Terminals:
    """Sources by role of the instrument and number of the channel, 0 at one with a single input."""

    def __init__(self) -> None:
        self._sources: dict[tuple[str, int], Source] = {}

    def connect(self, source: Source, role: str, channel: int = 0) -> None:
        """Wire a source to the terminals; whatever hung there before is taken away."""
        self._sources[role, channel] = source

    def source(self, role: str, channel: int = 0) -> Source | None:
        """Return the source at the terminals, None if they are open."""
        return self._sources.get((role, channel))
