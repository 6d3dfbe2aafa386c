"""Catalogues of texts: by key and language, English where a language has none."""

from __future__ import annotations

import copy
import json
import pickle
from dataclasses import dataclass
from pathlib import Path

import pytest

from bench.model.errors import InputError
from bench.model.texts import Said, Sayings, Texts, check_language, languages, told


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


def test_a_sentence_survives_being_kept_and_copied_and_is_plain_text_in_json(package: Path) -> None:
    sentence = Sayings(package)("wait", degC="1")
    for again in (pickle.loads(pickle.dumps(sentence)), copy.deepcopy(sentence)):
        assert again == sentence
        assert told(again, "ko") == "1 degC 에서 유지"
    assert json.dumps([sentence]) == '["soak at 1 degC"]'


def test_a_sentence_of_a_package_that_is_gone_stays_english(package: Path) -> None:
    assert told(Said("as it was", str(package / "gone"), "wait", {}), "ko") == "as it was"


def test_a_language_that_nobody_has_is_refused_with_those_that_are_there(package: Path) -> None:
    check_language("ko", package)
    with pytest.raises(InputError, match="no language 'kr'") as caught:
        check_language("kr", package)
    assert (caught.value.code, caught.value.next_step) == ("B-TXT-001", "use one of: en, de, ko")
