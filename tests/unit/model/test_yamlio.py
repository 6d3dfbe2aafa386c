"""The strict YAML loader: what it accepts, what it refuses, and where it says the mistake is."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, RootModel

from bench.model.errors import MAX_LISTED, ExitStatus, InputError, InputErrors
from bench.model.units import quantity
from bench.model.yamlio import MAX_BYTES, MAX_DEPTH, MAX_VALUES, StrictModel, load_yaml, parse_yaml


class Anything(RootModel[Any]):
    """Any YAML value."""


class Inner(StrictModel):
    current: Annotated[float, *quantity("A", 0.0, 1.0)]
    count: int = Field(1, ge=1, le=9)


class Outer(StrictModel):
    name: str
    inner: list[Inner] = Field(default_factory=list)


def value(text: str | bytes) -> Any:
    return parse_yaml(text, "t.yaml", Anything).model.root


def refused(text: str | bytes, schema: type = Anything) -> list[tuple[str, str]]:
    with pytest.raises(InputError) as caught:
        parse_yaml(text, "t.yaml", schema)
    error = caught.value
    assert error.exit_status is ExitStatus.BAD_INPUT
    return [(e.code, e.where) for e in (error.errors if isinstance(error, InputErrors) else [error])]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1e5", 100000.0),
        ("1.0e5", 100000.0),
        ("-.5E-3", -0.0005),
        ("010", "010"),
        ("0o10", "0o10"),
        ("0x1F", 31),
        ("+7", 7),
        ("1_000", "1_000"),
        ("on", "on"),
        ("off", "off"),
        ("yes", "yes"),
        ("True", "True"),
        ("true", True),
        ("null", None),
        ("~", None),
        ("1:30", "1:30"),
        ("00:00:20", "00:00:20"),
        ("2000-01-01", "2000-01-01"),
        (".inf", ".inf"),
        (".nan", ".nan"),
        ("1e999", "1e999"),
        ('"5"', "5"),
        ("18446744073709551615", 2**64 - 1),
        ("-9223372036854775808", -(2**63)),
        ("+", "+"),
        ("", None),
        ("# only a comment\n", None),
        ("\ufeffa: 1", {"a": 1}),
        ("a: [1, {b: 2}]", {"a": [1, {"b": 2}]}),
        ("'on': 1", {"on": 1}),
        ('"null": 1', {"null": 1}),
    ],
)
def test_plain_scalars_follow_yaml_1_2(text: str, expected: Any) -> None:
    found = value(text)
    assert found == expected
    assert type(found) is type(expected)


@pytest.mark.parametrize(
    ("text", "code", "where"),
    [
        (b"a: " + b"x" * MAX_BYTES, "B-YAML-002", "t.yaml"),
        (b"a: 1\nb: \xff", "B-YAML-003", "t.yaml:2:4"),
        ("a: [1, 2", "B-YAML-004", "t.yaml:1:9"),
        ("a:\n\t- 1", "B-YAML-004", "t.yaml:2:1"),
        ("a: 1\nb: *x", "B-YAML-005", "t.yaml:2:4"),
        ("a: &x 1", "B-YAML-005", "t.yaml:1:4"),
        ("a: 1\n---\nb: 2", "B-YAML-006", "t.yaml:2:1"),
        ("a: !!python/name:os.system x", "B-YAML-007", "t.yaml:1:4"),
        ("? [1]\n: 2", "B-YAML-009", "t.yaml:1:3"),
        ("null: 1", "B-YAML-009", "t.yaml:1:1"),
        ("a:\n  true: 1", "B-YAML-009", "t.yaml:2:3"),
        ("a: 1\n? ~\n: 2", "B-YAML-009", "t.yaml:2:3"),
        ("a: 1\nb: 2\na: 3", "B-YAML-014", "t.yaml:3:1"),
        ("a: b\x07c", "B-YAML-016", "t.yaml:1:5"),
        ("a: 1\nb: x\x00", "B-YAML-016", "t.yaml:2:5"),
        ("a: 1\n\ufeffb: 2", "B-YAML-016", "t.yaml:2:1"),
        ("a: 18446744073709551616", "B-YAML-018", "t.yaml:1:4"),
        ("a: " + "9" * 5000, "B-YAML-018", "t.yaml:1:4"),
        ("a: 0x" + "f" * 5000, "B-YAML-018", "t.yaml:1:4"),
    ],
)
def test_what_is_refused_and_where(text: str | bytes, code: str, where: str) -> None:
    assert refused(text) == [(code, where)]


def test_nesting_is_bounded_b_yaml_008() -> None:
    assert value("[" * MAX_DEPTH + "]" * MAX_DEPTH) is not None
    assert refused("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1)) == [("B-YAML-008", f"t.yaml:1:{MAX_DEPTH + 1}")]
    assert refused("[" * 100_000)[0][0] == "B-YAML-008"


def test_number_of_values_is_bounded_b_yaml_015() -> None:
    assert len(value("- 1\n" * (MAX_VALUES - 1))) == MAX_VALUES - 1
    assert refused("- 1\n" * MAX_VALUES) == [("B-YAML-015", f"t.yaml:{MAX_VALUES}:3")]


def test_unreadable_file_b_yaml_001(tmp_path: Path) -> None:
    for path in (tmp_path / "missing.yaml", tmp_path, Path("a\0b.yaml")):
        with pytest.raises(InputError) as caught:
            load_yaml(path, Anything)
        assert caught.value.code == "B-YAML-001"


def test_all_mistakes_at_once_in_order_of_position() -> None:
    text = "inner:\n  - {current: 5, count: 10}\n  - {curent: 1 A, count: 2, count: 3}\n  - {current: 2 A}\nwhat: 1\n"
    assert refused(text, Outer) == [
        ("B-YAML-011", "t.yaml:1:1"),  # name is missing
        ("B-YAML-012", "t.yaml:2:6"),  # a bare number where a unit is due
        ("B-YAML-013", "t.yaml:2:18"),  # over the limit
        ("B-YAML-011", "t.yaml:3:5"),
        ("B-YAML-010", "t.yaml:3:6"),
        ("B-YAML-014", "t.yaml:3:29"),
        ("B-YAML-012", "t.yaml:4:6"),
        ("B-YAML-010", "t.yaml:5:1"),
    ]


def test_messages_say_value_limit_and_key() -> None:
    with pytest.raises(InputErrors) as caught:
        parse_yaml("name: x\ninner: [{current: 2 A}]", "t.yaml", Outer)
    assert str(caught.value) == "error B-YAML-012: t.yaml:2:10: current: '2 A' is above the limit 1 A"


@pytest.mark.parametrize("text", ["", "5", "[1]", "text", "null"])
def test_another_shape_is_an_error_with_position(text: str) -> None:
    assert refused(text, Outer) == [("B-YAML-013", "t.yaml:1:1")]


def test_a_long_list_of_mistakes_is_cut_b_yaml_017() -> None:
    found = refused("name: x\ninner:\n" + "  - {current: 5 V}\n" * 5000, Outer)
    assert len(found) == MAX_LISTED + 1
    assert found[-1][0] == "B-YAML-017"


def test_position_of_a_value_and_of_its_nearest_parent() -> None:
    document = parse_yaml("name: x\ninner:\n  - {current: 1 A}\n", "t.yaml", Outer)
    assert document.where(("inner", 0, "current")) == "t.yaml:3:6"
    assert document.where(("inner", 0, "count")) == "t.yaml:3:5"
    assert document.where(()) == "t.yaml:1:1"
    assert document.text == "name: x\ninner:\n  - {current: 1 A}\n"


def test_alias_bomb_is_refused_before_it_unfolds() -> None:
    lines = ["a: &a [x, x, x, x, x, x, x, x, x]"]
    lines += [f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]" for a, b in zip("abcdefgh", "bcdefghi", strict=True)]
    assert refused("\n".join(lines)) == [("B-YAML-005", "t.yaml:1:4")]


def places(raw: bytes) -> list[str]:
    """Where each mistake is; empty if there is none."""
    try:
        parse_yaml(raw, "t.yaml", Outer)
    except InputErrors as error:
        return [single.where for single in error.errors]
    except InputError as error:
        return [error.where]
    return []


@given(st.binary(max_size=200) | st.text(max_size=200).map(lambda text: text.encode("utf-8", "surrogatepass")))
def test_any_bytes_are_a_value_or_errors_with_position(raw: bytes) -> None:
    assert all(re.fullmatch(r"t\.yaml:\d+:\d+", where) for where in places(raw))


LEAVES = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.text("ab: #-[]{}'\"\n", max_size=8)
TREES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("abc", min_size=1), inner, max_size=4),
)


@given(TREES)
def test_json_is_yaml_and_survives(tree: Any) -> None:
    assert value(json.dumps(tree)) == tree
