"""The laboratory file: the example is good, and every mistake has its place."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcc_sample import EXAMPLE

from bench.model.errors import InputError
from bench.report.dcc import load_laboratory


def load(tmp_path: Path, old: str, new: str) -> str:
    text = EXAMPLE.read_text()
    assert old in text
    path = tmp_path / "laboratory.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_laboratory(path)
    return str(caught.value)


def test_the_example_is_good() -> None:
    found = load_laboratory(EXAMPLE)
    assert found.laboratory.country == "DE"
    assert found.surroundings.temperature == (22.0, 24.0)
    assert found.surroundings.humidity == (0.3, 0.6)
    assert [one.signs for one in found.responsible] == [True, False]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("prefix: EX", "prefix: E X", "prefix"),
        ("country: DE", "country: Germany", "country"),
        ("signs: true", "signs: false", "nobody signs"),
        ("[22 degC, 24 degC]", "[24 degC, 22 degC]", "lower value first"),
        ("[22 degC, 24 degC]", "[22, 24]", "unit"),
        ("[30 %, 60 %]", "[30 %, 160 %]", "above the limit"),
        ("location: laboratory", "location: garden", "location"),
        ('# issued: "2026-11-21"', 'issued: "21.11.2026"', "YYYY-MM-DD"),
        ("prefix: EX", "prefix: EX\nfax: 1", "unknown key 'fax'"),
        ("  city: Exampletown\n", "", "'city' is missing"),
        ("order: EX-2026-001", "order: ''", "order"),
    ],
)
def test_a_mistake_is_told_with_its_place(tmp_path: Path, old: str, new: str, told: str) -> None:
    message = load(tmp_path, old, new)
    assert told in message
    assert "laboratory.yaml:" in message
    assert "B-YAML-" in message


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_laboratory(tmp_path / "none.yaml")
    assert caught.value.code == "B-YAML-001"
