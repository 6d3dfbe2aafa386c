"""The engine of doubt on least squares by hand: what is seen, how surely, and which estimates are doubted for it."""

from typing import Any

import numpy as np
import pytest

from bench.analysis import Departure, Labels, Residuals, departures_of, operators_of, search
from bench.maths.arrays import Floats

VISITS, RECORDS = 8, 6
HOURS = np.arange(VISITS * RECORDS) / 2.0
VISIT = np.repeat(np.arange(VISITS), RECORDS)
ONE = np.ones(VISIT.size)


def rows_of(white: Floats, design: Floats | None = None, **changes: Any) -> Residuals:
    """Return rows with unit noise; estimates are the means of the visits, or the parameters of a design."""
    design = 1.0 * np.equal.outer(VISIT, np.arange(VISITS)) if design is None else design
    operator = np.linalg.pinv(design)
    noise = 2.0 * np.linalg.norm(operator, axis=1)
    given: dict[str, Any] = {
        "readings": 1e6 * ONE,
        "white": white,
        "design": design,
        "scatter": np.zeros((VISIT.size, 0)),
        "whiten": lambda columns: columns,
        "operator": operator,
        "expanded": noise,
        "noise": noise,
        "on_curve": np.zeros(len(operator), bool),
    }
    return Residuals(**(given | changes))


def column(values: Floats, shape: str = "own", **words: Any) -> Departure:
    return Departure("", shape, "ppm", np.asarray(values, float).reshape(VISIT.size, -1), **words)


def false_rate(rows: Any, departures: list[Departure], draws: int) -> float:
    """Return the share of draws in which something is found that is not there."""
    rng = np.random.default_rng(52)
    return float(np.mean([bool(search(rows(rng), departures).findings) for _ in range(draws)]))


def test_many_columns_share_the_chance_of_a_false_finding() -> None:
    """400 campaigns by 200 columns: 0.1 % of them are 0.4, and more than 4 have a chance below 1e-4."""
    rng = np.random.default_rng(1)
    departures = [column(rng.normal(size=VISIT.size)) for _ in range(200)]
    assert false_rate(lambda rng: rows_of(rng.normal(size=VISIT.size)), departures, 400) <= 4 / 400


def test_scatter_of_unknown_size_is_told_by_its_other_directions() -> None:
    """Visits scatter by 30 times their noise: one visit is no departure by Student's t, and is one by known noise."""
    of_visits = 1.0 * np.equal.outer(VISIT, np.arange(VISITS))
    departures = [column(one) for one in of_visits.T]

    def drawn(rng: np.random.Generator, **changes: Any) -> Residuals:
        white = rng.normal(size=VISIT.size) + of_visits @ rng.normal(0.0, 30.0, VISITS)
        return rows_of(white, ONE[:, None], **changes)

    assert false_rate(lambda rng: drawn(rng, scatter=100.0 * of_visits), departures, 400) <= 4 / 400
    assert false_rate(drawn, departures, 50) == 1.0
    only_one = rows_of(np.random.default_rng(2).normal(size=VISIT.size) + 60.0 * of_visits[:, 3], ONE[:, None])
    assert search(only_one, departures).findings[0].departure is departures[3]


def test_noise_that_is_estimated_shows_less() -> None:
    departs = [column(HOURS)]
    white = np.random.default_rng(3).normal(size=VISIT.size) + 0.15 * HOURS
    assert search(rows_of(white, ONE[:, None]), departs).findings
    assert not search(rows_of(white, ONE[:, None], noise_dof=3.0), departs).findings


def test_what_explains_the_rows_as_well_is_judged_with_the_best() -> None:
    """Two columns that differ in one row of the last visit: only the second one moves that visit."""
    first = 1.0 * (VISIT == 0) * np.tile([1.0, -1.0, 1.0, -1.0, 1.0, 1.0], VISITS)
    second = first + 1.0 * (np.arange(VISIT.size) == VISIT.size - 1)
    white = 8.0 * first
    white[-1] = 3.6  # a little nearer to the first
    found = search(rows_of(white), [column(first), column(second, "other")])
    assert [one.departure.effect[-1, 0] for one in found.findings] == [0.0]
    assert found.doubted[[0, VISITS - 1]].all()
    assert not found.doubted[1:-1].any()


def test_both_sides_of_a_step_are_doubted() -> None:
    """Means of two items over all visits, and of each visit: the step is seen in the item that is in all visits."""
    labels = Labels(
        kinds={"item": VISIT % 2}, hours=HOURS, visit=VISIT, carriers={"gain": ("ppm", ONE)}, scopes=[("item",)]
    )
    mine = 1.0 * (VISIT % 2 == 0)
    white = np.random.default_rng(5).normal(size=VISIT.size) + 30.0 * mine * (VISIT >= 4)
    design = np.column_stack([mine, 1.0 - mine])
    of_visits = np.equal.outer(np.arange(VISITS), VISIT) / RECORDS
    wide = np.full(VISITS, 1.0)
    rows = rows_of(white, design, operator=of_visits, expanded=wide, noise=wide, on_curve=np.zeros(VISITS, bool))
    found = search(rows, [one for one in departures_of(labels) if one.family == "gain: step"])
    assert found.doubted.tolist() == [True, False] * (VISITS // 2)


def test_a_second_departure_is_searched_in_what_the_first_leaves() -> None:
    """Its size is that of least squares with both free, and all that rests on rows of two departures is doubted."""
    rng = np.random.default_rng(6)
    one, other = HOURS, np.sqrt(HOURS) + 0.1 * rng.normal(size=VISIT.size)
    white = rng.normal(size=VISIT.size) + 9.0 * one + 30.0 * other
    tiny = {"expanded": np.array([1e9]), "noise": np.array([1e-3])}
    found = search(rows_of(white, ONE[:, None], **tiny), [column(one), column(other)])
    assert len(found.findings) == 2
    least = np.linalg.lstsq(np.column_stack([ONE, one, other]), white, rcond=None)[0]
    assert found.findings[1].size == pytest.approx(least[1 + (found.findings[1].departure.effect[:, 0] == other).all()])
    assert found.findings[0].moves[0] < 0.3
    assert found.doubted.all()


def test_more_than_three_departures_are_not_told_one_by_one() -> None:
    """Five rows that are off: three are named, and all is doubted, coefficients of curves too."""
    each = np.eye(VISIT.size)[::9]
    white = np.random.default_rng(11).normal(size=VISIT.size) + 50.0 * each[:5].sum(axis=0)
    found = search(rows_of(white, on_curve=np.ones(VISITS, bool)), [column(one) for one in each])
    assert len(found.findings) == 3
    assert found.doubted.all()


def test_what_an_item_may_be_doubts_nothing_up_to_its_size() -> None:
    white = np.random.default_rng(7).normal(size=VISIT.size) + 10.0 * HOURS
    for own, doubted in ((20.0, False), (5.0, True)):
        (finding,) = (found := search(rows_of(white, ONE[:, None]), [column(HOURS, own=own)])).findings
        assert finding.size == pytest.approx(10.0, rel=0.02)
        assert (finding.moves[0] > 1.0, bool(found.doubted[0])) == (True, doubted)


def test_what_follows_from_no_reading_has_no_row() -> None:
    assert operators_of([], lambda entry: None, 60)[0].shape == (0, 60)


def test_a_part_of_a_reading_moves_it_by_its_square_too() -> None:
    white = np.random.default_rng(8).normal(size=VISIT.size) + 40.0 * (HOURS > 12.0)
    rows = rows_of(white, ONE[:, None], readings=100.0 * ONE)
    (finding,) = search(rows, [column(HOURS > 12.0)]).findings
    expected = np.array([40.0 + 40.0**2 / 100.0]) * np.mean(HOURS > 12.0) / rows.expanded
    assert finding.moves == pytest.approx(expected, rel=0.05)


def test_what_no_column_explains_widens_or_doubts() -> None:
    """Twice the noise, in the rows or beside them, would make each uncertainty twice as large; a curve carries it."""
    rng = np.random.default_rng(9)
    departures = [column(HOURS)]
    for white, rest in ((2.0 * rng.normal(size=VISIT.size), (0.0, 0)), (rng.normal(size=VISIT.size), (400.0, 100))):
        found = search(rows_of(white, rest=rest), departures)
        assert found.unexplained == pytest.approx(np.full(VISITS, 1.0), rel=0.25)
        assert found.doubted.all()
        on_curve = rows_of(white, rest=rest, on_curve=np.ones(VISITS, bool))
        assert not search(on_curve, departures).doubted.any()
    right = search(rows_of(rng.normal(size=VISIT.size), rest=(100.0, 100)), departures)
    assert right.is_noise
    assert not right.doubted.any()


def test_what_cannot_be_seen_is_named_with_the_size_that_counts() -> None:
    """All readings alike are the mean itself; half of them by 2 U of it, seen from the threshold on."""
    white = np.random.default_rng(10).normal(size=VISIT.size)
    half = 1.0 * (HOURS > 11.9)
    rows = rows_of(white, ONE[:, None])
    never, later = search(rows, [column(ONE, "all"), column(half, "half")]).unseen
    assert (never.departure.family, never.seen) == ("all", np.inf)
    assert never.size == pytest.approx(rows.expanded[0])
    assert later.size == pytest.approx(2.0 * rows.expanded[0])
    left = half - half.mean()
    assert later.seen == pytest.approx(3.29 / np.sqrt(left @ left), rel=0.01)  # 0.1 % on both sides
