"""Allan deviations of few averages whose limits are held against the truth, of noise that goes on and that changes."""

from collections.abc import Mapping

import numpy as np
from allan_simulation import record

from bench.maths.allan import allan_deviation
from bench.maths.allan_terms import allan_variance_of

SYSTEM = "allan"
SAMPLES = 1024
_WORLDS: Mapping[str, Mapping[str, float]] = {
    "white": {"white_noise": 1.0},
    "walk": {"random_walk": 1.0},
    "white into walk": {"white_noise": 1.0, "random_walk": 0.02},
    "steps into white": {"quantisation_noise": 10.0, "white_noise": 1.0},
    "steps into walk": {"quantisation_noise": 30.0, "random_walk": 0.02},
}
_AVERAGES = (16, 8, 4)  # that fit into the record


def inside(seed: int) -> dict[str, bool | None]:
    """Return of each noise and number of averages whether the limits hold the true deviation."""
    found: dict[str, bool | None] = {}
    for number, (name, terms) in enumerate(_WORLDS.items()):
        curve = allan_deviation(record(np.random.default_rng([seed, number]), SAMPLES, 1.0, **terms), 1.0)
        truth = np.sqrt(sum(size**2 * allan_variance_of(term, curve.tau_s) for term, size in terms.items()))
        for averages in _AVERAGES:
            (at,) = np.flatnonzero(SAMPLES // curve.factors == averages)
            found[f"{name}, {averages} averages"] = bool(curve.low[at] <= truth[at] <= curve.high[at])
    return found
