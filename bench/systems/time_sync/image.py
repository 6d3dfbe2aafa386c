"""The radar image of a recording, focused with the compensated navigation solution and with the one that is not.

From the first pulse on position and velocity of both solutions come from the inertial unit alone, the attitude is still
corrected: a correction of the position within the aperture would be a step of phase.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.analysis import Series, picture
from bench.maths.arrays import Floats
from bench.model.errors import FitError
from bench.systems.time_sync.estimators.sar.image import Chip, image_chip, levels_dB, point_targets
from bench.systems.time_sync.estimators.sar.pulses import Pulses, positions_at
from bench.systems.time_sync.estimators.sar.response import Response, impulse_response
from bench.systems.time_sync.filtering import COMPENSATED, GROUPS, NONE, Filtered
from bench.systems.time_sync.records import Stream
from bench.systems.time_sync.samples import steady_s

LEAST_PULSES = 2000


@dataclass(frozen=True)
class Image:
    """Responses of the targets, strongest first: ``compensated``, and ``plain`` without compensation.

    ``chips``: pieces of both images about the strongest target, compensated first.   ``speed_m_s``: along the track in
    the aperture.   ``pulses``: used.
    """

    compensated: list[Response]
    plain: list[Response]
    chips: tuple[Chip, Chip]
    speed_m_s: float
    pulses: int

    @property
    def shifts_m(self) -> Floats:
        """Of each target along the track, not compensated against compensated; positive = ahead."""
        return np.array([
            plain.azimuth.shift_m - compensated.azimuth.shift_m
            for plain, compensated in zip(self.plain, self.compensated, strict=True)
        ])  # fmt: skip


def drawn(chip: Chip, reference: float) -> Series:
    """Return levels of a piece of an image against a magnitude, 0 dB and less, as a picture."""
    return picture(chip.azimuth_m, chip.range_m, np.round(np.minimum(levels_dB(chip.value, reference), 0.0).T, 1))


def first_pulse_s(radar: Stream | None) -> float:
    """When the radar began, time of the inertial unit; infinite without a radar."""
    return float(radar.tick_s[0]) if radar is not None and len(radar) >= LEAST_PULSES else np.inf


def image_of(radar: Stream, result: Filtered) -> Image:
    """Find the targets, focus each with both solutions.

    Raises: FitError B-SYNC-010 if there is no image: too few pulses, no target that stands out, a response that is
            none.
    """
    fine = result.run.fine
    tags_s = steady_s(radar)
    use = radar.columns["status"] == 0
    if fine is not None and fine.t_s.size:
        use = use & (tags_s >= fine.t_s[0]) & (tags_s <= fine.t_s[-1])
    if fine is None or np.count_nonzero(use) < LEAST_PULSES:
        raise FitError(
            "B-SYNC-010",
            f"{int(np.count_nonzero(use))} sound pulses of the radar within the records, {LEAST_PULSES} are the least",
            next_step="keep the radar on for the whole aperture, before the last record ends",
        )
    sound = radar.part(use)
    echo = sound.columns["echo"]
    pulses = Pulses(
        gates=(echo[:, 0::2] + 1j * echo[:, 1::2]).astype(np.complex64),
        near_range_m=sound.columns["near_range"],
        spacing_m=float(sound.columns["spacing"][0]),
        wavelength_m=float(sound.columns["wavelength"][0]),
    )
    solutions = {
        name: positions_at(tags_s[use], fine.t_s, fine.p[:, GROUPS.index(name), 0], fine.v[:, GROUPS.index(name), 0])
        for name in (COMPENSATED, NONE)
    }
    targets_m = point_targets(pulses, solutions[COMPENSATED])
    responses = {
        name: [impulse_response(pulses, positions_m, target) for target in targets_m]
        for name, positions_m in solutions.items()
    }
    track_m = float(np.linalg.norm(solutions[COMPENSATED][-1] - solutions[COMPENSATED][0]))
    speed_m_s = track_m / float(tags_s[use][-1] - tags_s[use][0])
    chips = image_chip(pulses, solutions[COMPENSATED], targets_m[0]), image_chip(pulses, solutions[NONE], targets_m[0])
    return Image(responses[COMPENSATED], responses[NONE], chips, speed_m_s, len(sound))
