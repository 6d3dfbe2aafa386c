"""Check of uncertainty budgets by Monte Carlo: the whole model of a group is drawn and fitted again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.analysis import Table
from bench.maths.budget import Budget
from bench.maths.monte_carlo import Distribution, check_interval, propagate
from bench.systems.af_converter.budget_tables import figures
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
    rows = [_row(visit, budget, fitted, campaign, standards, method) for visit, budget in checked]
    return Table("Monte Carlo check of dsf_n", caption, list(_HEADERS), rows)


def trials_of(visit: GroupFit, fitted: Fitted, campaign: Campaign, standards: Standards, method: str) -> Distribution:
    """Distribution of DSF_N of a group, ppm."""
    at_degC = visit.fit.unit_temperature_degC
    model = TrialModel(
        rows=visit.group.closed,
        converter=campaign.converter(visit.group.channel),
        standard=standards.ranges,
        referral=Referral(at_degC, fitted.slopes_ppm_degC(visit.group.channel, at_degC)),
        method=method,
        common_relative=(standards.traceability or 0.0, standards.drift or 0.0),
        sensor_std_degC=campaign.sensor_std_degC,
    )
    return propagate(lambda generator, trials: model.draw(generator, trials)[:, 0], _SEED, TRIALS)


def _row(
    visit: GroupFit, budget: Budget, fitted: Fitted, campaign: Campaign, standards: Standards, method: str
) -> list[Any]:
    value_ppm, expanded_ppm = float(visit.fit.dsf_ppm[0]), budget.expanded_uncertainty
    drawn = trials_of(visit, fitted, campaign, standards, method)
    check = check_interval(value_ppm, budget.std_uncertainty, expanded_ppm, drawn)
    return [
        visit.group.channel,
        campaign.channel(visit.group.channel).kind,
        f"{visit.fit.unit_temperature_degC:.2f}",
        figures(budget.std_uncertainty),
        figures(drawn.std),
        _interval(value_ppm - expanded_ppm, value_ppm + expanded_ppm),
        _interval(drawn.low, drawn.high),
        f"{check.low_difference:.2f}, {check.high_difference:.2f}",
        f"{check.tolerance:g}",
        check.statement,
    ]


def _interval(low: float, high: float) -> str:
    return f"{low:.2f} … {high:.2f}".replace("-", "−")
