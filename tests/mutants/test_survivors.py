"""How survivors are counted: which tests are near, what is not mutated, the interval of a rate."""

from __future__ import annotations

import pytest
from survivors import mutants_of, wilson


def test_places_are_mutated_once_each_and_annotations_never() -> None:
    pytest.importorskip("cosmic_ray", reason="needs the extra mutation")
    text = "def f(x: int | None) -> int:\n    return x + 1\n"
    places = mutants_of("f.py", text)
    assert {mutant.line for mutants in places.values() for mutant in mutants} == {2}
    changed = {mutant.text(text) for mutants in places.values() for mutant in mutants}
    assert text.replace("+", "-") in changed
    assert text.replace("1", "2") in changed


def test_the_interval_of_a_rate() -> None:
    assert wilson(0, 0) == (0.0, 1.0)
    assert wilson(4, 20) == pytest.approx((0.0807, 0.4160), abs=1e-4)  # Brown, Cai, DasGupta 2001, equation (4)
    assert wilson(0, 20)[0] == 0.0
