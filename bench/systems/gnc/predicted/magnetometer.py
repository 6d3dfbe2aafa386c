"""What turns and attitudes in the declared field will know of a magnetometer, with the noise that is declared."""

from __future__ import annotations

from bench.analysis import Planned, Prediction
from bench.systems.gnc.estimators.magnetometer.plane import ELLIPSE
from bench.systems.gnc.limits import limits_of
from bench.systems.gnc.magnetometer import ITEMS, attitudes_of, plane_estimates, turns_of
from bench.systems.gnc.predicted.declared import magnetic_noise
from bench.systems.gnc.predicted.records import nominal_material
from bench.systems.gnc.roll_angle import nominal_answers, roll_estimates
from bench.systems.gnc.rows import sampled_rows
from bench.systems.gnc.sphere import Sphere, sphere_of
from bench.systems.gnc.wording import say


def predicted(planned: Planned) -> Prediction:
    """Return estimates of a nominal unit with the uncertainties that a calibration of the magnetometer will give.

    Raises:  FitError B-GNC-008 without declared noise or field; else as ``magnetometer.analyse``.
    """
    noise = magnetic_noise(planned.campaign)
    rows, missing = sampled_rows(nominal_material(planned, ("mag",)), ITEMS)
    fits, attitudes = turns_of(rows, missing, noise), attitudes_of(rows)
    sphere = sphere_of(attitudes, noise=noise) if attitudes else Sphere(missing=[say("note.no_attitudes")])
    plane, limit_deg = fits[0][1], limits_of(planned.campaign)["roll_error"]
    answers = nominal_answers(planned.exchanges, plane.ellipse.parameters.radius)
    rolls = roll_estimates(answers, plane.by_method, ELLIPSE, limit_deg, noise)
    return Prediction(plane_estimates(fits) + rolls + sphere.estimates, [*missing, *sphere.missing])
