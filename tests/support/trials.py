"""Tables of the report left out: the Monte Carlo takes half a second per campaign, and some tests analyse hundreds."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from bench.analysis import Table


@contextmanager
def without_trials() -> Iterator[None]:
    """Replace the table by an empty one; its own tests call it by its own module (test_budget_campaign.py)."""
    empty = Table("Monte Carlo check of dsf_n", "", [], [])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.systems.af_converter.scale_factor.budgets.check_table", lambda *_: empty)
        yield


@contextmanager
def without_budgets() -> Iterator[None]:
    """Leave out every table of a budget, for tests that read the estimates of many campaigns."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.systems.af_converter.scale_factor.analysis.budget_tables", lambda *_: [])
        yield
