"""The analysis of the probes."""

import numpy as np

from bench.analysis import Analysis, Material, estimate

METHODS = ("mean",)


def analyse(material: Material, method: str = "mean") -> Analysis:
    """Mean resistance of each probe at each temperature, and the air's mean beside it."""
    assert method == "mean"
    found: dict[tuple[float, str], list[float]] = {}
    for row in material.rows:
        for reading in material.readings_of(row):
            name = f"{reading.role} {reading.arguments.get('channel', 0)}"
            found.setdefault((reading.conditions["temperature_degC"], name), []).append(reading.value)
    estimates = [
        estimate(
            "air" if name.startswith("chamber") else "resistance", "degC" if name.startswith("chamber") else "ohm",
            float(np.mean(values)), 0.01, {"temperature_degC": temperature_degC, "probe": name}, n=len(values),
        )
        for (temperature_degC, name), values in found.items()
    ]  # fmt: skip
    return Analysis("probe_means", method, material.campaign["uut"], estimates)
