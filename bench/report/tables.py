"""Tables of a report: rows of text with the units in the header, and its fixed texts (texts/en.json)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from bench import analysis
from bench.analysis import Estimate, cell, header, number, unit_text
from bench.model.texts import ENGLISH, Texts, told

_COLUMNS = (
    *("time", "role", "manufacturer", "model", "serial", "firmware"),
    *("step", "text", "value", "unit", "low", "high", "by", "what", "reason"),
    *("kind", "quantity", "component", "evaluation", "distribution", "std_uncertainty_ppm"),
    *("range_A", "gain", "offset_A"),
)
_MOST_PLACES = 7  # behind the point; what needs more is printed with a power of ten
_PROSE = 40  # characters of a cell that is a sentence rather than a value
_NUMERAL = re.compile(r"-(?=[0-9])")
_NEGATIVE = re.compile(r"(?<![\w-])-(?=[0-9])")
_NO_SIZE = re.compile(r"-(0(?:\.0+)?)$")
_COMMA_UNIT = re.compile(
    r", (?=(?:°C(?:/min)?|ppm|ppb|min|h|%|1|m?deg(?:/s|/h|/√h)?|deg/√h|arcsec|mil|mrad|π|V RMS|m/s²|"
    r"[mµn]?[AVsg]|[kcm]?m|[kMG]?Hz|dB|[mµ]?gauss|10⁻³(?: arcsec| deg/√h)?)$)"
)
_PER_CENT = re.compile(r"(?<=[0-9]) %")
_CODE_NAME = re.compile(r"(?<![\w/.[])(?:[a-z][a-z0-9]*(?:_[A-Za-z0-9]+)+|tc[12])(?![\w/]|\.\w)", re.ASCII)
_BUDGET, _TOTALS = {"contribution", "sensitivity"}, {"u", "k", "U"}
FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Table:
    """A captioned table; the first ``stub`` columns head their row and are set flush left, all of them if ``prose``.

    ``goes_on``: it continues one with other columns, and its caption says so.
    """

    caption: str
    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    stub: int = 1
    prose: bool = False
    goes_on: bool = False


def table_of(
    words: Texts,
    caption: str,
    heads: Iterable[str],
    rows: Iterable[tuple[str, ...]],
    *,
    stub: int = 1,
    prose: bool = False,
) -> Table | None:
    """Return a table with headings of the catalogue, by their keys; None without rows."""
    lines = tuple(rows)
    return Table(caption, tuple(map(words, heads)), lines, stub=stub, prose=prose) if lines else None


Title = Callable[[str], str]
Key = TypeVar("Key")
Item = TypeVar("Item")


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Return items by key, in the order in which they come."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def spaced(name: str) -> str:
    """Return a code name with its underscores as blanks."""
    return name.replace("_", " ")


def named(text: str, title: Title = spaced) -> str:
    """Return a text for people: code names in it become titles, in small letters where they do not begin it."""

    def shown(match: re.Match[str]) -> str:
        name = title(match[0])
        return name[:1].lower() + name[1:] if match.start() and name[1:2].islower() else name

    return _CODE_NAME.sub(shown, text)


def analysis_tables(tables: Sequence[analysis.Table], language: str = ENGLISH, title: Title = spaced) -> list[Table]:
    """Return the tables of an analysis as text, laid out alike in every language; ``title``: of quantities it names."""
    return [
        Table(
            sentence(_caption(table, language), title),
            tuple(label(named(text, title)) for text in told(tuple(table.headers), language)),
            tuple(
                tuple(named(_plain(value, on_uncertainty(table)), title) for value in told(tuple(row), language))
                for row in table.rows
            ),
            stub=_stub(table.rows),
            prose=_is_prose(table),
        )
        for table in tables
    ]


def _caption(table: analysis.Table, language: str) -> str:
    """Return a title, alone or with the caption as sentences behind it; a full stop ends them."""
    heading, caption = told((table.title, table.caption), language)
    return f"{heading}. {caption.rstrip('.')}." if heading and caption else heading or caption


def _stub(rows: Sequence[Sequence[Any]]) -> int:
    """Two columns head the rows if the second one is of words."""
    return 2 if rows and all(len(row) > 1 and isinstance(row[1], str) and row[1][:1].isalpha() for row in rows) else 1


def _is_prose(table: analysis.Table) -> bool:
    """Return True for a table of words: it says so, is a budget, or has a cell that is a sentence."""
    if table.prose or set(table.headers) >= _BUDGET:
        return True
    return any(isinstance(value, str) and len(value) > _PROSE for row in table.rows for value in row)


def on_uncertainty(table: analysis.Table) -> bool:
    """Return True for a table of an analysis on its uncertainty: a budget, budgets side by side, or correlations."""
    heads = list(table.headers)
    square = heads[:1] == [""] and heads[1:] == [str(row[0]) for row in table.rows]
    return square or set(heads) >= _BUDGET or set(heads) >= _TOTALS


def label(text: str) -> str:
    """Return a heading of an analysis as the page prints it: ``width, degC`` becomes ``width / °C``."""
    return _COMMA_UNIT.sub(" / ", unit_text(text))


def sentence(text: str, title: Title = spaced) -> str:
    """Return a sentence of an analysis as the page prints it: with degrees, minus signs before numbers, and titles."""
    return named(_PER_CENT.sub("\u00a0%", _NEGATIVE.sub("−", unit_text(text))), title)


def _plain(value: Any, budget: bool) -> str:
    """Return a cell: four significant digits, of a budget three; a number as text gets its minus sign.

    Nothing is minus zero.
    """
    if isinstance(value, str):
        value = _NUMERAL.sub("−", _NO_SIZE.sub(r"\1", value)) if value[:1] == "-" else value
        return unit_text(_PER_CENT.sub("\u00a0%", value.replace(" ± ", "\u00a0±\u00a0")))
    if isinstance(value, float) and 0.0 < abs(value) < math.inf:
        places = (2 if budget else 3) - math.floor(math.log10(abs(value)))
        return number(value, max(0, places)) if places <= _MOST_PLACES else number(float(f"{value:.2e}"))
    return cell(value)


def documents_table(words: Texts, caption: str, documents: Sequence[Mapping[str, Any]]) -> Table | None:
    """Return a table of like documents: their keys are the columns, in an order of their own, whoever wrote them."""
    if not documents:
        return None
    keys = sorted({key for document in documents for key in document}, key=rank)
    rows = tuple(tuple(cell(document.get(key)) for key in keys) for document in documents)
    return Table(caption, tuple(column(words, key) for key in keys), rows, prose=True)


def rank(key: str) -> tuple[int, str]:
    """Sorts the keys of documents: known columns first."""
    return (_COLUMNS.index(key) if key in _COLUMNS else len(_COLUMNS), key)


def pairs_table(caption: str, headers: tuple[str, str], pairs: Mapping[str, Any], prose: bool = True) -> Table | None:
    """Return a two-column table of names and values; nested documents become dotted code names."""
    rows = tuple(_flat("", pairs))
    return Table(caption, headers, rows, prose=prose) if rows else None


def _flat(prefix: str, pairs: Mapping[str, Any]) -> Iterable[tuple[str, str]]:
    for name, value in pairs.items():
        if isinstance(value, Mapping):
            yield from _flat(f"{prefix}{name}.", dict(sorted(value.items())))
        else:
            yield f"{prefix}{name}" if prefix else spaced(name), cell(value)


def words_of(language: str) -> Texts:
    """Return the texts of the report in a language; English stands in for what it does not have."""
    return Texts(FOLDER, language)


def column(words: Texts, key: str) -> str:
    """Return the heading of a field: that of the catalogue, else made of the field's own name."""
    return words.all.get(f"column.{key}") or header(key)


def kind_of(words: Texts, kind: object) -> str:
    """Return the word for a kind of channel; a kind that the catalogue does not have stands as it is."""
    return words.all.get(f"kind.{kind}", str(kind))


def role_of(words: Texts, role: str) -> str:
    """Return the word for a role of a station; one that the catalogue does not have stands as it is."""
    return words.all.get(f"role.{role}") or spaced(role)


def place_of(words: Texts, name: str) -> str:
    """Return the name of a place that is measured, ``logger 101``, with the word for the role in it."""
    role, blank, channel = name.partition(" ")
    return role_of(words, role) + blank + channel


def channel_title(words: Texts, number: object, kind: object) -> str:
    """Return ``channel 1, gyro``: the title of a panel."""
    return words("channel.title", number=number, kind=kind_of(words, kind)) if kind else words("channel", number=number)


def alike_of(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the entries that are equal in all of two rows and more; {} of one row or none."""
    first = rows[0] if len(rows) > 1 else {}
    return {name: value for name, value in first.items() if all(row.get(name) == value for row in rows)}


def brief(row: Estimate) -> Estimate:
    """Return an estimate, with 4 digits of its value if it has no uncertainty; whole digits are kept."""
    value = row.value
    if row.expanded_uncertainty or not isinstance(value, float) or abs(value) >= 1000.0:
        return row
    return row.model_copy(update={"value": float(f"{value:.4g}")})
