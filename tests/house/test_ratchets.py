"""Figures of weight that only go down: whoever needs more of one takes it away elsewhere, or says why in the commit.

A ceiling is lowered to what ``make figures`` prints whenever a piece of work is done.
"""

from figures import counted, last_row, tokens_and_lines, walked
from tree import TOP
from ways import Walk

CEILINGS = {
    "tokens": 965_410,
    "tokens a line": 10.57,
    "files": 712,
    "dict[str, Any]": 474,
    "lines of tests": 91_556,
    "tests of several deep modules": 129,
    "words of docs": 59_603,
}
CEILINGS_OF_WAYS = {
    "files of a frame": 59,
    "files of a step": 86,
    "files of a check": 51,
    "changes in a decode": 20,
    "changes in a call": 144,
    "changes in the check of a step": 35.0,
}


def too_much(figures: dict[str, float], ceilings: dict[str, float]) -> list[str]:
    """Return a sentence for each figure above its ceiling."""
    return [
        f"{name}: {figures[name]:,} is {figures[name] - ceiling:g} above the ceiling of {ceiling:,}"
        for name, ceiling in ceilings.items()
        if figures[name] > ceiling
    ]


def test_what_is_counted_stays_below_its_ceiling() -> None:
    assert too_much(counted(), CEILINGS) == []


def test_the_ways_stay_below_their_ceilings() -> None:
    assert too_much(walked(), CEILINGS_OF_WAYS) == []


def test_a_figure_above_its_ceiling_is_told_by_name_and_by_how_much() -> None:
    assert too_much({"files": 880}, {"files": 876}) == ["files: 880 is 4 above the ceiling of 876"]
    assert too_much({"files": 876}, {"files": 876}) == []


def test_the_record_has_all_figures() -> None:
    assert list(last_row()) == ["when", *CEILINGS, *CEILINGS_OF_WAYS]


def test_comments_and_docstrings_weigh_nothing() -> None:
    bare = "def doubled(x: float) -> float:\n    return 2.0 * x\n"
    told = 'def doubled(x: float) -> float:\n    """Return twice x."""\n    # why\n    return 2.0 * x\n'
    assert tokens_and_lines(told) == tokens_and_lines(bare) == (14, 2)


def test_a_walk_counts_files_and_changes_between_them() -> None:
    walk = Walk()
    for file in ("a.py", "a.py", "b.py", "a.py"):
        code = compile("import sys\nframe = sys._getframe()", f"{TOP}/bench/{file}", "exec")
        space: dict[str, object] = {}
        exec(code.replace(co_name="decode"), space)
        walk.note(space["frame"], "call", None)  # type: ignore[arg-type]
        walk.note(space["frame"], "return", None)  # type: ignore[arg-type]
    assert (len(walk.files), walk.changes) == (2, 2)
