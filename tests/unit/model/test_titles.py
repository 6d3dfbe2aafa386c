"""Names of quantities for people: every quantity of the shipped systems has one."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from bench.model.systems import analyses
from bench.model.texts import Texts
from bench.model.titles import campaign_title, quantity_title, quantity_titles, sequence_title

TOP = Path(__file__).resolve().parents[3]
GOLDEN = sorted((TOP / "tests" / "golden" / "sessions").glob("*/*/results.json"))
SYSTEMS = TOP / "bench" / "systems"
HANGUL = re.compile("[가-힣]")
MADE = re.compile(r"\b(?:estimate|Measured)\(\s*\"([a-z0-9_]+)\"", re.MULTILINE)


@pytest.mark.parametrize(
    ("analysis", "quantity", "title"),
    [
        ("scale_factor", "dsf_n", "Scale-factor error N"),
        ("scale_factor", "dsf_n_tc1", "Scale-factor error N, temperature coefficient of first order"),
        ("bias_ramp", "master_clock_error_tc0", "Master-clock error at the reference temperature"),
        ("temperature_ramp", "second_meter_tc2", "second meter, temperature coefficient of second order"),
        ("gnc_unit_test", "supply_voltage_deviation", "Supply voltage, deviation from nominal"),
        ("readings", "rail_5V_repeatability", "rail 5V, repeatability"),
        ("an_analysis_of_a_lab", "dsf_n", "dsf n"),
    ],
)
def test_a_quantity_has_the_name_that_the_field_gives_it(analysis: str, quantity: str, title: str) -> None:
    assert quantity_title(analysis, quantity) == title


def test_english_stands_in_for_a_language_without_catalogue() -> None:
    assert quantity_title("scale_factor", "bias", "xx") == "Bias"
    assert quantity_titles("noise_of_mine", "own_value") == {"en": "own value"}


@pytest.mark.parametrize("analysis", sorted(analyses()))
def test_every_shipped_analysis_has_a_title_in_both_languages(analysis: str) -> None:
    assert campaign_title(analysis)[0].isupper()
    assert HANGUL.search(campaign_title(analysis, "ko"))


def test_an_analysis_of_a_lab_keeps_its_name() -> None:
    assert campaign_title("noise_of_mine", "ko") == "noise of mine"


@pytest.mark.parametrize("path", sorted((TOP / "sequences").glob("*.yaml")), ids=lambda path: path.stem)
def test_a_shipped_sequence_has_its_title_in_korean_and_one_of_a_lab_its_own(path: Path) -> None:
    stated = dict(re.findall(r"^(sequence|title|analysis): (.*)$", path.read_text("utf-8"), re.MULTILINE))
    if "analysis" not in stated:
        pytest.skip("it has no report")
    where = stated["analysis"], stated["sequence"]
    assert sequence_title(*where, stated["title"]) == stated["title"]
    assert HANGUL.search(sequence_title(*where, stated["title"], "ko"))
    assert sequence_title(*where, "A copy of mine", "ko") == "A copy of mine"


@pytest.mark.parametrize("path", GOLDEN, ids=lambda path: path.parent.name)
def test_every_quantity_of_a_recorded_campaign_has_a_title(path: Path) -> None:
    results = json.loads(path.read_text(encoding="utf-8"))
    for quantity in {estimate["quantity"] for estimate in results["estimates"]}:
        title = quantity_title(results["campaign"], quantity)
        assert title[0].isupper() or results["campaign"] == "temperature_ramp", quantity  # columns keep their names
        assert "_" not in title


@pytest.mark.parametrize("system", sorted(path.parent.name for path in SYSTEMS.glob("*/texts")))
def test_every_quantity_that_a_system_names_in_full_has_a_title(system: str) -> None:
    analysis = next(name for name, (_, declared, _) in analyses().items() if declared.name == system)
    sources = [path.read_text("utf-8") for path in (SYSTEMS / system).rglob("*.py")]
    lacking = {
        quantity
        for source in sources
        for quantity in MADE.findall(source)
        if not quantity_title(analysis, quantity)[0].isupper()
    }
    assert not lacking


@pytest.mark.parametrize("folder", sorted(path.parent for path in SYSTEMS.glob("*/texts")), ids=lambda path: path.name)
def test_titles_begin_like_a_heading_and_differ(folder: Path) -> None:
    texts = {key: text for key, text in Texts(folder).all.items() if key.startswith("quantity.")}
    assert all(text[0].isupper() for text in texts.values())
    assert len(set(texts.values())) == len(texts)
