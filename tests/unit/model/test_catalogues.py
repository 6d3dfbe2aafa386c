"""Every catalogue of the product: complete in every language, the same fields, no word left in English."""

from __future__ import annotations

import json
import re
import string
from pathlib import Path

import pytest

import bench
from bench.model.texts import ENGLISH

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


def test_the_catalogues_are_those_that_people_read() -> None:
    assert {"report", "tui", "web"} <= set(FOLDERS)


def test_the_methods_that_a_report_describes_are_described_in_korean() -> None:
    english, korean = texts("report/dcc", ENGLISH), texts("report/dcc", KOREAN)
    assert korean.keys() == {key for key in english if key.startswith("method.") and key.endswith(".description")} - {
        "method.uncertainty.description"
    }
    assert all(fields(text) == fields(english[key]) and left_over(text) <= {"AF"} for key, text in korean.items())


@pytest.mark.parametrize("folder", FOLDERS)
def test_korean_has_every_text_with_the_same_fields(folder: str) -> None:
    english, korean = texts(folder, ENGLISH), texts(folder, KOREAN)
    assert {key: english[key] for key in sorted(english.keys() - korean.keys())} == {}
    assert korean.keys() - english.keys() == set()
    assert {key for key, text in korean.items() if fields(text) != fields(english[key])} == set()


@pytest.mark.parametrize("folder", FOLDERS)
def test_nothing_is_left_in_english(folder: str) -> None:
    same = {"language.name"}
    found = {
        key: words for key, text in texts(folder, KOREAN).items() if key not in same and (words := left_over(text))
    }
    assert found == {}


@pytest.mark.parametrize("folder", FOLDERS)
def test_no_particle_hangs_on_a_field(folder: str) -> None:
    assert {key: text for key, text in texts(folder, KOREAN).items() if PARTICLE.search(EITHER.sub("}", text))} == {}


def test_what_is_left_over_is_found() -> None:
    assert left_over("채널 {channel}, 값 Value 'bench run' dsf_n 1.5 ppm.") == {"Value"}
    assert fields("{value:.2f} of {n}") == {("value", ".2f"), ("n", "")}
    assert PARTICLE.search("{name}은 없습니다")
    assert not PARTICLE.search(EITHER.sub("}", "{name}은(는) 없습니다, {time}까지"))
