"""What plain readings will show of their repeatability, where their scatter is declared."""

from __future__ import annotations

from bench.analysis import Planned, Prediction, foreseen_material, values_of
from bench.systems.readings.analysis import repeatabilities
from bench.systems.readings.wording import say


def predicted(planned: Planned) -> Prediction:
    """Return repeatabilities with the uncertainties that so many readings of the declared scatter will give."""
    values = values_of(foreseen_material(planned)[0])
    names = ", ".join(str(fit["name"]) for fit in planned.campaign.get("fits", ()))
    return Prediction(repeatabilities(values), [say("predicted.no_fit", names=names)] if names else [])
