"""A run that was away for a time nobody knows: what depends on that time is doubtful, the rest stays as it is."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from bench.analysis import Analysis, Evidence, estimate, weigh
from bench.model.clock import NS
from bench.model.events import Environment, Resume
from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import RecordRow
from bench.replay import Splice
from bench.session.away import doubted, placed_later

KNOWN = Splice(2 * NS, None, None, 5.0, 3, "crash", None, None, False)
UNKNOWN = replace(KNOWN, at_ns=6 * NS, away_s=None, step=8, placed=False)
AIR = Environment(air_degC=20.0, unit_degC=21.0)


def row(number: int, start_s: float) -> RecordRow:
    window = RecordWindow(number, "port_a", 100 * number, 100, round(start_s * NS), round((start_s + 1) * NS))
    return RecordRow(window, {"npp": np.array([3, 0])}, 100, 0, 0, Quality.GOOD)


def found(*values: float, evidence: list[Evidence] | None = None, expanded: float = 2.0) -> Analysis:
    entries = [
        estimate(name, "1", value, expanded / 2.0, {"channel": 1}, n=9, factor=2.0)
        for name, value in zip(("dsf", "drift"), values, strict=False)
    ]
    return Analysis("any", "wls", {}, entries, evidence or [])


def of_quality(analysis: Analysis) -> list[bool]:
    """Whether each estimate is sound."""
    against = weigh(analysis.evidence).against
    return [not any(check.bears_on(entry) for check in against) for entry in analysis.estimates]


def test_only_what_lies_behind_a_splice_of_unknown_length_is_placed_later() -> None:
    rows = [row(1, 0.0), row(2, 3.0), row(3, 7.0), row(4, 8.0)]
    events = [(NS, AIR), (2 * NS, Resume(reason="x")), (6 * NS, AIR), (6 * NS, Resume(reason="x")), (7 * NS, AIR)]
    later_rows, later = placed_later(rows, events, [KNOWN, UNKNOWN], 3600.0)
    assert [one.window.t_start_ns / NS for one in later_rows] == [0.0, 3.0, 3607.0, 3608.0]
    assert [t_ns / NS for t_ns, _ in later] == [1.0, 2.0, 6.0, 3606.0, 3607.0]
    counters = [one.window.first_counter for one in later_rows]
    assert counters[2] - counters[1] == pytest.approx(100 * 3604, rel=0.01), "frames that would have come meanwhile"
    assert counters[3] - counters[2] == 100


def test_an_estimate_that_depends_on_the_time_away_is_doubtful_and_no_other() -> None:
    analysis = doubted(found(1.0, 5.0), [found(1.0, 5.0), found(1.1, 9.0)], [KNOWN, UNKNOWN])
    assert of_quality(analysis) == [True, False]
    (against,) = weigh(analysis.evidence).against
    assert (against.code, against.figure) == ("unknown_time_away", 2.0)
    assert "step 8 " in against.sentence
    assert "1 of 2 estimates" in analysis.notes[-1]


@pytest.mark.parametrize(
    "other",
    [
        None,  # cannot be made at all
        found(1.0),  # an estimate less
        found(1.0, 5.0, expanded=3.0),
        found(1.0, math.nan),
        found(1.0, 5.0, evidence=[Evidence("bent", "bent", None, 0.0, quantities=("drift",))]),
    ],
)
def test_whatever_is_otherwise_with_a_longer_time_away_counts(other: Analysis | None) -> None:
    assert not of_quality(doubted(found(1.0, 5.0), [other], [UNKNOWN]))[1]


def test_numbers_that_are_not_known_either_way_are_the_same() -> None:
    assert of_quality(doubted(found(1.0, math.nan), [found(1.0, math.nan)], [UNKNOWN])) == [True, True]
    exact = found(1.0, 5.0, expanded=0.0)
    assert of_quality(doubted(exact, [exact], [UNKNOWN])) == [True, True]
    assert of_quality(doubted(exact, [found(1.0, 5.1, expanded=0.0)], [UNKNOWN])) == [True, False]
