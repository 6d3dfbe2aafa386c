"""What no record of a ring laser can show, by name.

Source: docs/decisions/0025-doubt.md; equations (2), (6) and (10) of docs/ring-laser.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.assumptions import Assumption

_OUTPUTS = ("angle_random_walk", "quantisation_noise", "alignment_time")


def assumptions(campaign: Mapping[str, Any]) -> list[Assumption]:
    """Return what a campaign takes for granted; ``campaign``: that section of a plan or manifest."""
    return [_gain(), _clock(), _latitude(campaign), _base(), _longer(), _beat_phase()]


def _gain() -> Assumption:
    return Assumption(
        "path_length",
        "The ring is square, its perimeter is the path length of the record, and the light has 632.8 nm: K = pi L / (2 "
        "lambda).",
        "5 % of K, which is when counted and sensed dither disagree; the sensor itself is good to 1 %.",
        "1 % of K is 1 % of lock-in rate and random walk, and 2 % of the alignment time. Ratios and the backscatter "
        "phase do not change.",
        "Turn the block by whole turns on a table and divide the count by them.",
        ("lock_in_rate", *_OUTPUTS),
    )


def _clock() -> Assumption:
    return Assumption(
        "tagger_clock",
        "The clock of the time tagger has the frequency that its blocks state.",
        "5 %, which is when counted and sensed dither disagree.",
        "A clock that is 1 % fast makes the lock-in rate 1 % too small and the random walk 0.5 %. Crystals are good to "
        "50 ppm.",
        "Time-stamp the pulse per second of a GNSS receiver on a free channel of the tagger.",
        ("lock_in_rate", *_OUTPUTS),
    )


def _latitude(campaign: Mapping[str, Any]) -> Assumption:
    latitude_deg = (campaign.get("site") or {}).get("latitude_deg")
    per_degree = "" if latitude_deg is None else _per_degree(float(latitude_deg))
    return Assumption(
        "latitude",
        "The latitude of the site and Earth's rate of 15.041067 deg/h.",
        "Any size: nothing in the records depends on it.",
        f"The alignment time goes with 1 / cos^2 of the latitude{per_degree}.",
        "A map, or a GNSS receiver on the site.",
        ("alignment_time",),
    )


def _per_degree(latitude_deg: float) -> str:
    share = 2.0 * math.radians(1.0) * abs(math.tan(math.radians(latitude_deg)))
    return f": at {latitude_deg:g} deg, 1 deg is {100.0 * share:.2g} % of it"


def _base() -> Assumption:
    return Assumption(
        "still_base",
        "The base turns at a constant rate. A drift, a step or a single frequency would be seen.",
        "White noise of the base's rate, of any size: it adds to every output as the laser's own does.",
        "The random walk behind a compensator is that of laser and base together. A base of 1e-4 deg/h^0.5 is as much "
        "as the quantum noise at 28 cm.",
        "Record two lasers on one plate at the same time: what they share is the base.",
        ("angle_random_walk", "alignment_time", "random_walk_ratio", "alignment_time_ratio"),
    )


def _longer() -> Assumption:
    return Assumption(
        "longer_than_the_record",
        "The gyroscope goes on as it did in the record: nothing but random walk for as long as an alignment takes.",
        "Any wander of the bias that is slower than the record, and any change of lock-in with temperature.",
        "The alignment time is that of random walk alone. At N = 1e-3 deg/h^0.5 a bias that wanders by 2e-3 deg/h over "
        "900 s makes as large an error again.",
        "Record for as long as the alignment takes, at the temperatures of its use.",
        ("alignment_time",),
    )


def _beat_phase() -> Assumption:
    return Assumption(
        "phase_of_the_beat",
        "The comparators switch where the optical phase of the beat is a multiple of pi: nothing between mixing prism "
        "and comparator turns it.",
        "Any angle that both comparators share.",
        "The backscatter phase is off by that angle. Nothing else changes, for only differences count there.",
        "Set the mirror transducers to the least random walk at no input rate, or measure both scattered beams.",
        ("backscatter_phase",),
    )
