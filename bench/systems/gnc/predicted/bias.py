"""What records at rest will know of biases, their stability and repeatability, with the noise that is declared."""

from __future__ import annotations

from bench.analysis import Planned, Prediction
from bench.systems.gnc.bias import (
    ITEMS,
    flip_estimates,
    gyro_estimates,
    repeatability_estimates,
    stability_estimates,
)
from bench.systems.gnc.limits import limits_of
from bench.systems.gnc.predicted.declared import noise_of
from bench.systems.gnc.predicted.records import nominal_material
from bench.systems.gnc.rows import sampled_rows
from bench.systems.gnc.wording import say


def predicted(planned: Planned) -> Prediction:
    """Return estimates of a nominal unit with the uncertainties that its records at rest will give.

    Stability and repeatability are the expected ones of the declared noise.

    Raises:  FitError as ``bias.analyse``.
    """
    material = nominal_material(planned, ("gyro", "accel"))
    rows, missing = sampled_rows(material, ITEMS)
    by_item = {item: [row for row in rows if row.item == item] for item in ITEMS}
    missing += [say("missing.item", item=item) for item in ITEMS if not by_item[item]]
    found = {kind: noise_of(planned.campaign, kind, missing) for kind in ("gyro", "accelerometer")}
    declared = {kind: noise for kind, noise in found.items() if noise is not None}
    estimates = gyro_estimates(by_item["bias"], material, missing, declared)
    estimates += flip_estimates(by_item["flip"], material, missing, [], declared)
    estimates += stability_estimates(by_item["stability"], limits_of(planned.campaign), missing, declared)[1]
    estimates += repeatability_estimates(by_item["repeatability"], missing, declared)
    return Prediction(estimates, missing)
