"""What all unit tests share."""

from collections.abc import Iterator

import pytest
from trials import without_trials

from bench.report import sheet


@pytest.fixture
def no_korean_font(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Have no font with Korean letters, as without the extra 'ko'."""
    monkeypatch.setattr("bench.report.fonts._korean_folder", lambda: None)
    for known in (sheet._fonts, sheet._advance):
        known.cache_clear()
    yield
    for known in (sheet._fonts, sheet._advance):
        known.cache_clear()


@pytest.fixture(autouse=True, scope="module")  # a worker runs tests of other folders too
def _no_trials() -> Iterator[None]:
    with without_trials():
        yield
