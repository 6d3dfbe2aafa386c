"""Catalogues of texts and names of quantities: complete, English where a language has none."""

import copy
import json
import pickle
import re
import string
from dataclasses import dataclass
from pathlib import Path

import pytest

import bench
from bench.model.errors import InputError
from bench.model.texts import (
    ENGLISH,
    Said,
    Sayings,
    Texts,
    check_language,
    languages,
    quantity_title,
    sequence_title,
    told,
)


@dataclass(frozen=True)
class Item:
    """What a report may hold."""

    text: str
    number: int


@pytest.fixture
def package(tmp_path: Path) -> Path:
    (tmp_path / "texts").mkdir()
    catalogues = {
        "en": {"state.holding": "HOLDING", "wait": "soak at {degC} degC"},
        "ko": {"wait": "{degC} degC 에서 유지"},
        "de": {"state.holding": "HÄLT"},
    }
    for language, texts in catalogues.items():
        (tmp_path / "texts" / f"{language}.json").write_text(json.dumps(texts), encoding="utf-8")
    return tmp_path


def test_texts_by_key_english_for_what_a_language_lacks(package: Path) -> None:
    assert Texts(package)("wait", degC="50.0") == "soak at 50.0 degC"
    korean = Texts(package, "ko")
    assert korean("wait", degC="-10.0") == "-10.0 degC 에서 유지"
    assert korean("state.holding") == "HOLDING"
    assert set(korean.all) == set(Texts(package).all)
    with pytest.raises(KeyError):
        Texts(package, "ko")("no.such.key")
    assert languages(package) == ["en", "de", "ko"]
    check_language("ko", package)
    with pytest.raises(InputError, match="no language 'kr'") as caught:
        check_language("kr", package)
    assert (caught.value.code, caught.value.next_step) == ("B-TXT-001", "use one of: en, de, ko")


def test_a_sentence_is_english_and_is_told_in_another_language(package: Path) -> None:
    say = Sayings(package)
    inner = say("wait", degC=f"{50.0:.1f}")
    assert isinstance(inner, str)
    assert inner == "soak at 50.0 degC"
    assert told(inner, "ko") == "50.0 degC 에서 유지"
    assert told(inner, "en") == told(inner, "xx") == inner
    assert told(say("state.holding"), "ko") == "HOLDING"
    with pytest.raises(KeyError):
        say("no.such.key")


def test_a_sentence_inside_others_and_inside_documents_is_told_too(package: Path) -> None:
    say = Sayings(package)
    outer = say("wait", degC=say("wait", degC="1"))
    assert outer == "soak at soak at 1 degC degC"
    assert told(outer, "ko") == "1 degC 에서 유지 degC 에서 유지"
    document = {"rows": [(say("wait", degC="1"), 7)], "item": Item(say("wait", degC="2"), 3)}
    assert told(document, "ko") == {"rows": [("1 degC 에서 유지", 7)], "item": Item("2 degC 에서 유지", 3)}
    assert told(document, "en") is document


def test_a_sentence_survives_being_kept_copied_or_left_alone(package: Path) -> None:
    sentence = Sayings(package)("wait", degC="1")
    for again in (pickle.loads(pickle.dumps(sentence)), copy.deepcopy(sentence)):
        assert again == sentence
        assert told(again, "ko") == "1 degC 에서 유지"
    assert json.dumps([sentence]) == '["soak at 1 degC"]'
    assert told(Said("as it was", str(package / "gone"), "wait", {}), "ko") == "as it was"


TOP = Path(__file__).resolve().parents[3]
GOLDEN = sorted((TOP / "tests" / "golden" / "sessions").glob("*/*/results.json"))
HANGUL = re.compile("[가-힣]")


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


ROOT = Path(bench.__file__).parent
KOREAN = "ko"
# A certificate has its texts in English; the schema of the DCC gives each text a language of its own.
ONE_LANGUAGE = {"report/dcc"}
FOLDERS = sorted(
    str(path.parent.parent.relative_to(ROOT))
    for path in ROOT.rglob(f"texts/{ENGLISH}.json")
    if str(path.parent.parent.relative_to(ROOT)) not in ONE_LANGUAGE
)
# Symbols, units, names of files and products, and letters of the formulae: the same in both languages.
SAME = {
    "E", "F", "K", "L", "NATO", "arcsec", "cm", "cos", "e-3", "e-4", "lambda", "mdeg", "mil", "nm", "ns", "pi", "rad",
    "TIP", "TVP", "U1", "U2", "X", "i", "k-1", "likelihood", "mV", "mrad", "phi",
    "A", "AF", "B", "C", "CAN", "CRC", "Clopper", "D", "DMM", "EGI", "GNSS", "Hz", "IDN", "IMU", "JavaScript", "MHz",
    "N", "P", "PDF", "Pearson", "SHA-256", "SPI", "U", "UTC", "V", "Welch-Satterthwaite", "answer", "batch.json",
    "bench", "d", "deg", "degC", "degC2", "degC3", "h", "k", "log", "mA", "min", "ms", "n", "nA", "ppm", "q",
    "results.json",
    "AD", "CPU", "DIP", "El-Sheimy", "GHz", "GNC", "GPS", "IO", "ISLR", "NIS", "PSLR", "SCI", "Y", "Youssef",
    "Z", "a", "arcmin", "b", "dB", "g", "gauss", "km", "m", "mg", "mgauss", "s2", "sqrt", "ug", "us", "w", "z",
    "GUM", "IEEE", "JCGM", "Std", "r", "s", "tc1", "tc2", "u", "x", "y",
}  # fmt: skip
CODE = re.compile(r"\{[^}]*\}|--[a-z]+|'[^']*'|[a-z]+(?:_[a-z0-9]+)+")  # fields, commands, options, names of columns
WORD = re.compile(r"[A-Za-z][A-Za-z0-9.-]*")
PARTICLE = re.compile(r"\}(?:은|는|이|가|을|를|와|과|로|으로)(?![가-힣(])")  # which one depends on what the field is
EITHER = re.compile(r"\}(?:은\(는\)|이\(가\)|을\(를\)|와\(과\)|\(으\)로)")


def texts(folder: str, language: str) -> dict[str, str]:
    path = ROOT / folder / "texts" / f"{language}.json"
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def fields(text: str) -> set[tuple[str, str]]:
    """Return fields of a text with their formats: a number has the same digits in every language."""
    return {(name, form or "") for _, name, form, _ in string.Formatter().parse(text) if name is not None}


def left_over(text: str) -> set[str]:
    return {word.strip(".-") for word in WORD.findall(CODE.sub(" ", text))} - SAME


def test_the_methods_that_a_report_describes_are_described_in_korean() -> None:
    english, korean = texts("report/dcc", ENGLISH), texts("report/dcc", KOREAN)
    assert korean.keys() == {key for key in english if key.startswith("method.") and key.endswith(".description")} - {
        "method.uncertainty.description"
    }
    assert all(fields(text) == fields(english[key]) and left_over(text) <= {"AF"} for key, text in korean.items())


@pytest.mark.parametrize("folder", FOLDERS)
def test_korean_has_every_text_with_the_same_fields_and_nothing_left_in_english(folder: str) -> None:
    english, korean = texts(folder, ENGLISH), texts(folder, KOREAN)
    assert {key: english[key] for key in sorted(english.keys() - korean.keys())} == {}
    assert korean.keys() - english.keys() == set()
    assert {key for key, text in korean.items() if fields(text) != fields(english[key])} == set()
    left = {key: words for key, text in korean.items() if key != "language.name" and (words := left_over(text))}
    assert left == {}
    assert {key: text for key, text in korean.items() if PARTICLE.search(EITHER.sub("}", text))} == {}
