"""The raw waveform of a set: output against the encoder, as the records hold it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Floats
from bench.systems.north.sets import NorthSet

if TYPE_CHECKING:
    from bench.record import Samples


@dataclass(frozen=True)
class Waveform:
    """Samples of a set: ``u_V`` and ``theta_deg`` (n,), ``record`` (n,) index position; ``rate_Hz`` of the samples."""

    u_V: Floats
    theta_deg: Floats
    record: NDArray[np.int64]
    rate_Hz: float

    @property
    def seconds(self) -> float:
        """How long was measured."""
        return len(self.u_V) / self.rate_Hz

    @property
    def swing_deg(self) -> float:
        """RMS of what a steady rotation leaves of the encoder angle, degrees."""
        squares = []
        for record in np.unique(self.record):
            theta_deg = np.unwrap(self.theta_deg[self.record == record], period=360.0)
            at = np.linspace(-1.0, 1.0, len(theta_deg))
            slope = float(at @ theta_deg) / float(at @ at)
            squares.append(np.mean((theta_deg - theta_deg.mean() - slope * at) ** 2))
        return float(np.sqrt(np.mean(squares)))

    def standing(self) -> list[int]:
        """Return records in which the table turned at less than half of the highest rate of the set, or backwards."""
        per_sample_deg = {}
        for record in np.unique(self.record).tolist():
            theta_deg = np.unwrap(self.theta_deg[self.record == record], period=360.0)
            per_sample_deg[record] = float(theta_deg[-1] - theta_deg[0]) / len(theta_deg)
        fastest_deg = max(per_sample_deg.values(), key=abs)
        return [record for record, each in per_sample_deg.items() if not each / fastest_deg > 0.5]

    def turns(self, record: int) -> tuple[Floats, Floats, float]:
        """Output (n,) V, unwrapped table angle (n,) deg and samples per turn of one record."""
        own = self.record == record
        theta_deg = np.unwrap(self.theta_deg[own], period=360.0)
        per_turn = 360.0 * (len(theta_deg) - 1) / max(abs(float(theta_deg[-1] - theta_deg[0])), 1e-9)
        return self.u_V[own], theta_deg, per_turn


def waveform_of(one: NorthSet) -> Waveform | None:
    """Return the four records of a set in one; None if any of them is missing or has gaps."""
    if one.raw_faults:
        return None
    samples = [(index, row.samples) for index, row in sorted(one.rows.items()) if row.samples is not None]
    return Waveform(
        u_V=np.concatenate([each.scaled("output") for _, each in samples]),
        theta_deg=np.concatenate([each.scaled("encoder") for _, each in samples]),
        record=np.concatenate([np.full(len(each), index, np.int64) for index, each in samples]),
        rate_Hz=float(np.mean([_rate_Hz(each, one.rate_deg_s) for _, each in samples])),
    )


def _rate_Hz(samples: Samples, rate_deg_s: float) -> float:
    """Return samples per second by the turning of the table: a serial line hands samples over in blocks."""
    theta_deg = np.unwrap(samples.scaled("encoder"), period=360.0)
    return (len(samples) - 1) * abs(rate_deg_s) / max(abs(float(theta_deg[-1] - theta_deg[0])), 1e-9)
