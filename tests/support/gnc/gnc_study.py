"""What is predicted of a GNC campaign against many simulated units of its plan."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from gnc_campaigns import Module, calibration_truth, campaign, left_by, material_of, records_of
from spread_study import Key, Study

from bench.analysis import Analysis, Material
from bench.plan import Plan
from bench.session.predicted import predicted
from bench.systems.gnc.calibration import analysis as calibration


def study(
    plan: Plan,
    analyse: Callable[[Material], Analysis],
    truth: Callable[[Module, Analysis], Mapping[Key, float]],
    first_seed: int,
    units: int,
    answering: Callable[[Material, Plan, Module], Material] = lambda material, *_: material,
) -> Study:
    """Units of seeds that follow each other; ``answering``: what adds their answers to commands."""
    found = Study(predicted(plan))
    records = records_of(plan)
    for seed in range(first_seed, first_seed + units):
        module = campaign(records, seed, plan.campaign["rate_Hz"])
        analysis = analyse(answering(material_of(plan, module), plan, module))
        found.add(analysis.estimates, truth(module, analysis))
    print(f"seeds {first_seed} to {first_seed + units - 1}")
    print(*found.lines(), sep="\n")
    print(f"median of {len(found.scores)} quantities {found.median():.3f}; outside of 99.9 %: {found.outside()}")
    return found


def calibration_study(plan: Plan, first_seed: int, units: int) -> Study:
    """Calibrations of units of seeds that follow each other."""
    return study(
        plan,
        calibration.analyse,
        lambda module, analysis: calibration_truth(module) | left_by(module, analysis.estimates),
        first_seed,
        units,
    )
