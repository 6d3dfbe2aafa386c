"""The strict YAML loader and quantities: what they accept, what they refuse, and where the mistake is."""

import json
import math
import re
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, RootModel, TypeAdapter, ValidationError

from bench.model.errors import MAX_LISTED, ExitStatus, InputError, InputErrors
from bench.model.units import format_quantity, likely, parse_quantity, quantity, read_quantity, with_prefix
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
        ("010", "010"),
        ("0x1F", 31),
        ("1_000", "1_000"),
        ("on", "on"),
        ("true", True),
        ("null", None),
        ("00:00:20", "00:00:20"),
        ("2000-01-01", "2000-01-01"),
        (".inf", ".inf"),
        ("1e999", "1e999"),
        ('"5"', "5"),
        ("18446744073709551615", 2**64 - 1),
        ("-9223372036854775808", -(2**63)),
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


REFUSED = yaml.safe_load(Path(__file__).with_name("refused.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("text", "code", "where", "words"), REFUSED)
def test_what_is_refused_where_and_in_which_words(text: str | bytes, code: str, where: str, words: str) -> None:
    with pytest.raises(InputError, match=re.escape(f"{code}: t.yaml{where}: ")) as caught:
        value(text)
    assert words in str(caught.value)
    assert "Next: " in str(caught.value)


def test_nesting_is_bounded_b_yaml_008() -> None:
    assert value("[" * MAX_DEPTH + "]" * MAX_DEPTH) is not None
    assert refused("[" * (MAX_DEPTH + 1) + "]" * (MAX_DEPTH + 1)) == [("B-YAML-008", f"t.yaml:1:{MAX_DEPTH + 1}")]
    assert refused("[" * 100_000)[0][0] == "B-YAML-008"


def test_size_and_number_of_values_are_bounded_b_yaml_002_b_yaml_015() -> None:
    assert refused(b"a: " + b"x" * MAX_BYTES) == [("B-YAML-002", "t.yaml")]
    assert len(value("- 1\n" * (MAX_VALUES - 1))) == MAX_VALUES - 1
    assert refused("- 1\n" * MAX_VALUES) == [("B-YAML-015", f"t.yaml:{MAX_VALUES}:3")]


def test_unreadable_file_b_yaml_001(tmp_path: Path) -> None:
    for path in (tmp_path / "missing.yaml", tmp_path, Path("a\0b.yaml")):
        with pytest.raises(InputError, match="B-YAML-001"):
            load_yaml(path, Anything)


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
    for shape in ("", "5", "[1]", "text", "null"):
        assert refused(shape, Outer) == [("B-YAML-013", "t.yaml:1:1")]


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


@pytest.mark.parametrize(
    ("size", "unit", "factor", "shown"),
    [
        (0.9994, "V", 1e3, "mV"),
        (3e-5, "A", 1e6, "uA"),
        (0.0134, "s", 1e3, "ms"),
        (1.6e9, "s", 1.0, "s"),
        (0.0, "V", 1.0, "V"),
        (63.5, "deg", 1.0, "deg"),
    ],
)
def test_a_prefix_leaves_one_to_three_digits(size: float, unit: str, factor: float, shown: str) -> None:
    found, printed = with_prefix(size, unit)
    assert (found, printed) == (pytest.approx(factor), shown)


@pytest.mark.parametrize(
    ("text", "dimension", "expected"),
    [
        ("30 uA", "A", 3e-5),
        ("30 µA", "A", 3e-5),
        ("1.25 uC", "C", 1.25e-6),
        ("256 kHz", "Hz", 256e3),
        ("1 Mohm", "ohm", 1e6),
        ("0.5 degC/min", "degC/min", 0.5),
        ("20 ppm", "1", 2e-5),
        ("0.1 %", "1", 1e-3),
        ("8 ppm/degC", "1/degC", 8e-6),
        ("1e-3 A", "A", 1e-3),
        (" +.5 mA ", "A", 5e-4),
    ],
)
def test_the_nearest_float_of_the_written_decimal(text: str, dimension: str, expected: float) -> None:
    assert parse_quantity(text, dimension) == expected
    assert read_quantity(text) == (expected, dimension)


@pytest.mark.parametrize(
    ("symbols", "plain", "dimension"),
    [
        ("23 °C", "23 degC", "degC"),
        ("23 \N{DEGREE CELSIUS}", "23 degC", "degC"),
        ("50 \N{GREEK CAPITAL LETTER OMEGA}", "50 ohm", "ohm"),
        ("50 \N{OHM SIGN}", "50 ohm", "ohm"),
        ("3 \N{MICRO SIGN}V", "3 uV", "V"),
        ("3 \N{GREEK SMALL LETTER MU}V", "3 uV", "V"),
        ("45°", "45 deg", "deg"),
        ("3 °/h", "3 deg/h", "deg/s"),
        ("9.81 m/s²", "9.81 m/s2", "m/s2"),
    ],
)
def test_symbols_of_the_si_are_units(symbols: str, plain: str, dimension: str) -> None:
    assert parse_quantity(symbols, dimension) == parse_quantity(plain, dimension)
    assert read_quantity(symbols) == read_quantity(plain) == (parse_quantity(plain, dimension), dimension)


@pytest.mark.parametrize(
    ("text", "dimension", "meant"),
    [
        ("10 ma", "A", "10 mA"),
        ("10 MA", "V", ""),
        ("5 Ohm", "ohm", "5 ohm"),
        ("10 S", "s", "10 s"),
        ("-10 C", "degC", "-10 degC"),
        ("3 dps", "deg/s", "3 deg/s"),
        ("3 m/s^2", "m/s2", "3 m/s2"),
        ("10 apples", "A", ""),
        ("10 V", "A", ""),
        ("10", "A", ""),
        ("mA", "A", ""),
    ],
)
def test_the_unit_that_was_meant(text: str, dimension: str, meant: str) -> None:
    said = f"; did you mean {meant!r}?" if meant else ""
    assert likely(text, dimension) == said
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - its words follow
        parse_quantity(text, dimension)
    assert ("did you mean" in str(refused.value)) == bool(meant)
    assert str(refused.value).endswith(said)


def test_of_any_dimension_and_never_itself() -> None:
    assert likely("10 Deg/h") == "; did you mean '10 deg/h'?"
    assert (likely("10 deg/h"), likely("-1 mA", "A"), likely(10, "A"), likely("10 parsec")) == ("", "", "", "")


@pytest.mark.parametrize(
    "text", [10, 10.0, True, None, "10", "10 ", "mA", "", "1 2 A", "ten A", "1e5", "nan A", "inf A"]
)
def test_no_number_or_no_unit_is_refused(text: object) -> None:
    with pytest.raises(ValueError, match=r"quantity|unit"):
        parse_quantity(text, "A")


@given(
    st.decimals(-1000, 1000, allow_nan=False, allow_infinity=False, places=6), st.sampled_from(["", "m", "u", "n", "k"])
)
def test_prefixes_against_exact_fractions(number: Decimal, prefix: str) -> None:
    factor = {
        "": Fraction(1),
        "m": Fraction(1, 10**3),
        "u": Fraction(1, 10**6),
        "n": Fraction(1, 10**9),
        "k": Fraction(10**3),
    }
    assert parse_quantity(f"{number:f} {prefix}A", "A") == float(Fraction(number) * factor[prefix])


def test_limits_are_part_of_the_annotation_and_other_text_is_left_alone() -> None:
    adapter: TypeAdapter[float] = TypeAdapter(Annotated[float, *quantity("A", 0.0, 0.22)])
    assert adapter.validate_python("220 mA") == 0.22
    for text, says in (("221 mA", "above the limit 0.22 A"), ("-1 nA", "below the limit 0 A")):
        with pytest.raises(ValidationError, match=says):
            adapter.validate_python(text)
    for text in ("lowest_that_holds", "1-6", "+", "5", "{level}", "10 apples"):
        assert read_quantity(text) is None


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [(3e-5, "A", "30 uA"), (0.22, "A", "220 mA"), (1e7, "Hz", "10 MHz"), (0.0, "A", "0 A"), (20.0, "degC", "20 degC"),
     (-1.5e-9, "A", "-1.5 nA"), (1e-15, "A", "1e-15 A"), (math.inf, "A", "inf A")],
)  # fmt: skip
def test_printing(value: float, unit: str, text: str) -> None:
    assert format_quantity(value, unit) == text


@given(st.floats(1e-11, 1e9))
def test_printing_with_all_digits_reads_back(value: float) -> None:
    assert parse_quantity(format_quantity(value, "A", 17), "A") == pytest.approx(value, rel=3e-16)
