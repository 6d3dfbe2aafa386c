"""What all unit tests share."""

from collections.abc import Iterator

import pytest
from trials import without_trials


@pytest.fixture(autouse=True, scope="module")  # a worker runs tests of other folders too
def _no_trials() -> Iterator[None]:
    with without_trials():
        yield
