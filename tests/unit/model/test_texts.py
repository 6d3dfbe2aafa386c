"""Catalogues of texts: by key and language, English where a language has none."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from bench.model.texts import Texts, languages


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


def test_a_text_is_filled_with_its_values(package: Path) -> None:
    assert Texts(package)("wait", degC="50.0") == "soak at 50.0 degC"


def test_english_stands_in_for_what_a_language_lacks(package: Path) -> None:
    korean = Texts(package, "ko")
    assert korean("wait", degC="-10.0") == "-10.0 degC 에서 유지"
    assert korean("state.holding") == "HOLDING"
    assert set(korean.all) == set(Texts(package).all)


def test_an_unknown_key_is_an_error_of_the_program(package: Path) -> None:
    with pytest.raises(KeyError):
        Texts(package, "ko")("no.such.key")


def test_languages_of_a_package(package: Path) -> None:
    assert languages(package) == ["en", "de", "ko"]
