"""The survey of logs of other people: no spoiled log gives a wrong sound number, an internal error or a warning."""

from itertools import product

import pytest
from spoiled_logs import LOGS, SIZES, SPOILT, wrong


@pytest.mark.parametrize("kind", SPOILT)
def test_a_spoiled_log_gives_no_wrong_sound_number(kind) -> None:
    assert [line for analysis in LOGS for line in wrong(analysis, kind, 1.0, 0)] == []


@pytest.mark.sweep
def test_five_hundred_spoiled_logs() -> None:
    worlds = list(product(LOGS, SPOILT, SIZES))
    lines = [line for k in range(504) for line in wrong(*worlds[k % len(worlds)], k // len(worlds))]
    print("\n".join(lines))
    assert lines == []
