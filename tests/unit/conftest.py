"""What all unit tests share."""

from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True, scope="session")
def _no_trials() -> Iterator[None]:
    """The Monte Carlo table of the report takes half a second per campaign; some tests analyse five hundred.

    Its own tests call it by its own module (test_budget_campaign.py).
    """
    empty = {"title": "Monte Carlo check of dsf_n", "caption": "", "headers": [], "rows": []}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bench.systems.af_converter.scale_factor.budgets.check_table", lambda *_: empty)
        yield
