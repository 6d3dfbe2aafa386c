"""Check of uncertainty budgets by Monte Carlo: the whole model of a group is drawn and fitted again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.maths.budget import Budget
from bench.maths.monte_carlo import Distribution, check_interval, propagate
from bench.systems.af_converter.budget_tables import Table, figures
from bench.systems.af_converter.constants import Campaign, Standards
from bench.systems.af_converter.estimators.scale_factor import Referral
from bench.systems.af_converter.estimators.scale_factor_trials import TrialModel
from bench.systems.af_converter.group_fit import Fitted, GroupFit

TRIALS = 100_000
_SEED = 1  # any will do; the same numbers must come out tomorrow
_HEADERS = (
    "channel", "kind", "unit degC", "u budget", "u trials", "budget 95 %", "shortest 95 % of the trials",
    "ends differ by", "tolerance", "statement",
)  # fmt: skip


def check_table(
    checked: Sequence[tuple[GroupFit, Budget]], fitted: Fitted, campaign: Campaign, standards: Standards, method: str
) -> Table:
    """The budgets of dsf_n beside the shortest intervals of the trials, with the test of JCGM 101:2008 clause 8.1."""
    caption = (
        f"{TRIALS} trials each, every input drawn from its distribution, every draw fitted again; ppm. Tolerance: "
        "half a unit in the second digit of u. 'Not resolved': the scatter of the trials is too large to tell"
    )
    rows = [_row(one, budget, fitted, campaign, standards, method) for one, budget in checked]
    return {"title": "Monte Carlo check of dsf_n", "caption": caption, "headers": list(_HEADERS), "rows": rows}


def trials_of(one: GroupFit, fitted: Fitted, campaign: Campaign, standards: Standards, method: str) -> Distribution:
    """Distribution of DSF_N of a group, ppm."""
    at_degC = one.fit.unit_temperature_degC
    model = TrialModel(
        rows=one.group.closed,
        converter=campaign.converter(one.group.channel),
        standard=standards.ranges,
        referral=Referral(at_degC, fitted.slopes_ppm_degC(one.group.channel, at_degC)),
        method=method,
        common_relative=(standards.traceability or 0.0, standards.drift or 0.0),
        sensor_std_degC=campaign.sensor_std_degC,
    )
    return propagate(lambda generator, trials: model.draw(generator, trials)[:, 0], _SEED, TRIALS)


def _row(
    one: GroupFit, budget: Budget, fitted: Fitted, campaign: Campaign, standards: Standards, method: str
) -> list[Any]:
    value_ppm, expanded_ppm = float(one.fit.dsf_ppm[0]), budget.expanded_uncertainty
    found = trials_of(one, fitted, campaign, standards, method)
    check = check_interval(value_ppm, budget.std_uncertainty, expanded_ppm, found)
    return [
        one.group.channel,
        campaign.channel(one.group.channel).kind,
        f"{one.fit.unit_temperature_degC:.2f}",
        figures(budget.std_uncertainty),
        figures(found.std),
        _interval(value_ppm - expanded_ppm, value_ppm + expanded_ppm),
        _interval(found.low, found.high),
        f"{check.low_difference:.2f}, {check.high_difference:.2f}",
        f"{check.tolerance:g}",
        check.statement,
    ]


def _interval(low: float, high: float) -> str:
    return f"{low:.2f} … {high:.2f}".replace("-", "−")
