"""What a report of a calibration says about its conditions, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

from bench.analysis import no_result
from bench.systems.gnc.calibration.fitted import Calibration
from bench.systems.gnc.estimators.rotations import RotationFit
from bench.systems.gnc.rows import SampledRow, temperature_span

WARM_degC = 0.5  # over the records of a set; sensors of this class drift by some 30 ppm and 3 deg/h per degree


def calibration_notes(calibration: Calibration) -> list[str]:
    """Return what is missing, what widened the intervals, what they do not hold."""
    notes = no_result(calibration.missing)
    gyro = None if calibration.gyro is None else calibration.gyro.triad
    for name, fit in (("accelerometers", calibration.accelerometer), ("gyros", gyro)):
        if fit is not None and fit.inflated:
            notes.append(
                f"The residuals of the {name} are larger than noise and resolution explain (chi-square {fit.chi2:.0f} "
                f"with {fit.residual_dof} degrees of freedom); the intervals were widened for it. A tilt of the table "
                "from pose to pose looks like this."
            )
    for name, rows in (("positions", calibration.sets.positions), ("rotations", calibration.sets.rotations)):
        notes += _of_the_unit(name, list(rows.values()), calibration)
    if calibration.gyro is not None:
        notes += _of_the_turns(calibration.gyro, calibration)
    if calibration.sets.surplus:
        notes.append(f"{calibration.sets.surplus} records of a third time and later were not used.")
    if calibration.accelerometer_check or calibration.gyro_check:
        notes.append(
            "Coupling after compensation is what these coefficients leave, and its interval that of the second set: "
            "another calibration of the unit has other coefficients and leaves something else."
        )
    return [*notes, _of_the_table(calibration.tilt_deg)]


def _of_the_turns(fit: RotationFit, calibration: Calibration) -> list[str]:
    clock = calibration.clock
    notes = [
        f"The unit's clock is {1e6 * clock.error:+.1f} ± {2e6 * clock.std:.1f} ppm fast against the bench clock; "
        "the integrals are in seconds of the bench."
    ]
    if fit.drift_deg_s > 0.0:
        notes.append(
            f"From one rotation to the next the gyros' bias differs by {3600.0 * fit.drift_deg_s:.1f} deg/h "
            "more than noise explains (standard deviation); it is in the intervals."
        )
    cut_s = {name: cut for name, cut in fit.trimmed_s.items() if cut > 0.0}
    notes += [f"{name}: {cut:.3f} s were cut off its end, so that both directions are of equal length."
              for name, cut in cut_s.items()]  # fmt: skip
    notes += [f"{name}: {count} samples that came twice were left out."
              for name, count in fit.duplicates.items() if count]  # fmt: skip
    return notes


def _of_the_table(tilt_deg: float) -> str:
    if tilt_deg:
        return (
            f"A tilt of {60.0 * tilt_deg:.3g} arcmin (standard uncertainty, about each axis of each pose) is included; "
            "angles of turn and gravity are taken as stated."
        )
    return (
        "Angles of the table and gravity are taken as stated: their uncertainty is not included. A tilt of 1 arcmin "
        "puts the couplings off by some 200 ppm; 'tilt' of the site states it."
    )


def _of_the_unit(name: str, rows: Sequence[SampledRow], calibration: Calibration) -> list[str]:
    """Return what the unit went through between the records of one set."""
    if not rows:
        return []
    notes = []
    if not calibration.one_power_on(rows):
        notes.append(
            f"The unit was switched off between the {name}: each power-on has its own bias. Intervals were taken from "
            f"how well the {name} agree; for the best ones take all {name} again without a break."
        )
    low, high = temperature_span(rows)
    if high - low > WARM_degC:
        notes.append(
            f"The unit's temperature moved from {low:.2f} to {high:.2f} degC over the {name} (more than {WARM_degC:g} "
            "degC): bias and scale drift with it, and no interval holds that; let it warm up longer."
        )
    return notes
