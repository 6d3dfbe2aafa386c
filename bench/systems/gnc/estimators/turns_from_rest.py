"""Gyroscope triad from one turn about each axis and its output at rest, as hand-held calibrations give it.

Source: Ferraris, Grimaldi and Parvis, Procedure for effortless in-field calibration of three-axis rate gyros and
accelerometers, Sensors and Materials 7 (1995); GNC module paper equation (1), corrected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.systems.gnc.estimators.records import RotationRecord, good_samples, record_about
from bench.systems.gnc.estimators.rotation_inputs import Declared, Inputs
from bench.systems.gnc.estimators.triad import AXES, TriadFit, propagate_inputs
from bench.systems.gnc.estimators.turning import whole_turn

Array = NDArray[np.float64]


def fit_turns_from_rest(
    records: Sequence[RotationRecord], rest: Array, rest_covariance: Array, density: Array, declared: Declared
) -> TriadFit:
    """Fit S and bias where each axis was turned once only: the bias comes from records at rest.

    Args:    records: three, one turn about each body axis, rates in deg/s.   rest: (3,) mean output at rest, deg/s.
             rest_covariance: (3, 3) of it.   density: (3, 3) white noise (deg/s)^2 s (covariance at rest times its
             length).   declared: uncertainties of the turns.
    Returns: TriadFit, w = K N - bias; the Earth's rate is left in. There are no residuals.
    Raises:  FitError B-FIT-080, -081 and -082 as ``fit_rotations``.
    Source:  Ferraris, Grimaldi and Parvis 1995 (bias at rest, turns of 360 degrees); GNC module paper (1), corrected.
    """
    ordered = [record_about(records, axis, None) for axis in AXES]
    turns = [whole_turn(record, good_samples(record), rest) for record in ordered]
    inputs = Inputs.of([(turn,) for turn in turns], None)

    def parameters(vector: Array) -> Array:
        there, offset = inputs.at(vector[3:]), vector[:3]
        clear = there.integral - offset * there.duration_s[:, None]
        inverse = np.linalg.inv(np.linalg.solve(there.known, clear).T)
        return np.concatenate([inverse.ravel(), inverse @ offset])

    vector = np.concatenate([rest, inputs.vector])
    covariance = np.zeros((vector.size,) * 2)
    covariance[:3, :3] = rest_covariance
    covariance[3:, 3:] = inputs.covariance(declared, None, density, np.zeros((3, 3)))
    found = parameters(vector)
    return TriadFit(
        matrix=found[:9].reshape(3, 3),
        bias=found[9:],
        covariance=propagate_inputs(parameters, vector, covariance),
        residual=np.zeros((3, 3)),
        chi2=0.0,
        residual_dof=0,
        dof=math.inf,
        condition=float(np.linalg.cond(inputs.known / np.linalg.norm(inputs.known, axis=0))),
    )
