"""Repeats of a channel that do not lie on a steady drift: the bound of the drift says nothing of what happened then.

The temperature coefficients take a change of the calibrator as steady, and an order of temperatures that eliminates a
steady drift lets a step through. An opening, a middle and a closing visit tell the two apart.
Source: docs/decisions/0049-the-shortest-plan.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy import special

from bench.analysis import Estimates, Evidence
from bench.systems.af_converter.group_fit import Fitted
from bench.systems.af_converter.groups import place_name
from bench.systems.af_converter.scale_factor.calibrator_drift import Pair, change_ppm
from bench.systems.af_converter.scale_factor.common_step import COEFFICIENTS
from bench.systems.af_converter.wording import say

Array = NDArray[np.float64]
_MEAN = np.array([-0.5, -0.5])  # a calibrator that delivers more makes both counters count more
_SMALLEST = 1e-300  # a chance that is lost in the arithmetic is still one


def unsteady(pairs: Sequence[Pair], fitted: Fitted, entries: Estimates) -> list[Evidence]:
    """Return of each channel that is repeated more than once whether its changes lie on a straight line in time.

    Visits whose levels do not lie on a line say nothing of the calibrator, and those of a channel without temperature
    coefficients nothing that warming could not.
    """
    of_channel: dict[int, list[Pair]] = {}
    for pair in pairs:
        channel = pair[1].group.channel
        if fitted.knows_slopes(channel) and all(visit.fits for visit in pair):
            of_channel.setdefault(channel, []).append(pair)
    return [_judged(repeated, fitted, entries) for repeated in of_channel.values() if len(repeated) > 1]


def _judged(pairs: Sequence[Pair], fitted: Fitted, entries: Estimates) -> Evidence:
    start = pairs[0][0]
    time_s = np.array([again.fit.time_s - start.fit.time_s for start, again in pairs])
    change = np.array([float(_MEAN @ change_ppm(start, again, fitted)[0]) for start, again in pairs])
    own = [float(_MEAN @ again.fit.noise_ppm2 @ _MEAN) for _, again in pairs]
    covariance = np.diag(own) + float(_MEAN @ start.fit.noise_ppm2 @ _MEAN)
    weighted = np.linalg.solve(covariance, time_s)
    left = change - time_s * (weighted @ change) / (weighted @ time_s)
    chi2 = float(left @ np.linalg.solve(covariance, left))
    probability = max(float(special.chdtrc(len(pairs) - 1, chi2)), _SMALLEST)
    worst_ppm = float(np.abs(left).max())
    move = worst_ppm * _worst_move(fitted, entries)
    sentence = say("evidence.unsteady_drift", place=place_name(start.group.place), left=worst_ppm, move=move)
    return Evidence("unsteady_drift", sentence, worst_ppm, probability, move, tuple(chain(*COEFFICIENTS.values())))


def _worst_move(fitted: Fitted, entries: Estimates) -> float:
    """Return by how much of its expanded uncertainty a step of 1 ppm at the worst time moves a coefficient."""
    stated = {
        (entry["quantity"], entry["conditions"].get("channel")): entry["expanded_uncertainty"] for entry in entries
    }
    moves = [0.0]
    for (quantity, channel), polynomial in fitted.polynomials.items():
        if quantity in COEFFICIENTS:
            time_s = np.array([visit.fit.time_s for visit in fitted.visits(channel)])
            steps = np.array([time_s > at_s for at_s in time_s], dtype=np.float64)
            of_orders = np.abs(polynomial.operator[1:] @ steps.T).max(axis=1)
            names = COEFFICIENTS[quantity][: of_orders.size]
            moves += [move / stated[name, channel] for name, move in zip(names, of_orders.tolist(), strict=True)]
    return max(moves)
