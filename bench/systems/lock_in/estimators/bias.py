"""Bias instability of an output and the alignment error that it leaves, however long the alignment takes."""

from __future__ import annotations

import math
from dataclasses import dataclass

from bench.maths.allan import AllanDeviation
from bench.maths.allan_terms import fit_noise_terms
from bench.systems.lock_in.estimators.random_walk import TERMS, EARTH_RATE_deg_h

_BIAS = "bias_instability"


@dataclass(frozen=True)
class BiasInstability:
    """Bias instability B, deg/h; ``std_deg_h`` is NaN where it was fitted as 0.

    ``upper_deg_h``: not exceeded with 95 % confidence.   ``shown``: without it the fit is worse than chance explains.
    """

    value_deg_h: float
    std_deg_h: float
    upper_deg_h: float
    shown: bool


def bias_instability(output: AllanDeviation) -> BiasInstability:
    """Fit B beside random walk and quantisation to the Allan deviation of an output, deg/h.

    Raises: FitError of ``fit_noise_terms``.
    Source: IEEE Std 952-1997 annex C, equation C.13.
    """
    term = fit_noise_terms(output, (*TERMS, _BIAS))[_BIAS]
    shown = term.significant and term.coefficient > 0.0
    return BiasInstability(term.coefficient, term.std_uncertainty, term.upper_limit, shown)


def bias_alignment_error_deg(bias_deg_h: float, latitude_deg: float) -> float:
    """Return the heading error of a gyrocompass by a bias of its gyroscopes, psi = B / (W_e cos lat), degree.

    Args:    bias_deg_h: bias stability, for which the bias instability is taken.   latitude_deg: of the site.
    Source:  lock-in paper equation (1): it does not fall with the time of the alignment.
    """
    return math.degrees(bias_deg_h / (EARTH_RATE_deg_h * math.cos(math.radians(latitude_deg))))
