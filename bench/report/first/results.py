"""The results that matter, small enough for the first page: what the analysis declares as main, in few tables.

Channels go down and temperatures across, several quantities side by side; what has no such conditions is a list.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from bench.analysis import Estimate, cell, decimals_for, is_sound, number, unit_text, with_uncertainty
from bench.maths.verdict import worst
from bench.model.texts import Texts, quantity_title
from bench.report.estimate_tables import condition_head, condition_scale, condition_value, readable
from bench.report.model import ReportModel
from bench.report.tables import grouped, kind_of

ROOM_pt = 493.0  # the width of an A4 page inside its margins
_LETTER_pt, _GAP_pt = 4.15, 4.6  # of the type of 6.5 pt that the tables are set in
MOST_ROWS, MOST_LINES, _MOST_ACROSS = 12, 34, 5
_TEMPERATURE = "temperature_degC"
_ACROSS = (_TEMPERATURE, "axis", "column", "unit")
MEASURED = "unit_temperature_degC"
NOT_SOUND = "†"
Key = tuple[Any, ...]


@dataclass(frozen=True)
class Block:
    """A small table: ``groups`` are headings over several columns, each with their number; ``foot``: U, k, verdict."""

    caption: str
    groups: tuple[tuple[str, int], ...]
    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    foot: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class _Grid:
    """One quantity: its estimates by what goes down and what goes across; () and None where nothing varies."""

    campaign: str
    heading: str
    scale: float
    names: tuple[str, ...]
    across: str | None
    rows: Mapping[tuple[Key, Any], Estimate]
    cut: bool = False

    @property
    def down(self) -> list[Key]:
        return _ordered([key for key, _ in self.rows])

    @property
    def columns(self) -> list[Any]:
        return _ordered([value for _, value in self.rows])

    @property
    def places(self) -> int | None:
        """Decimals of a value without an uncertainty: no more than those with one have."""
        known = [row.expanded_uncertainty * self.scale for row in self.rows.values() if row.expanded_uncertainty]
        return decimals_for(max(known)) if known else None

    def thinned(self, most: int) -> _Grid:
        """Return it with at most so many columns: both ends, and others evenly between."""
        columns = self.columns
        if len(columns) <= most:
            return self
        kept = {columns[round(place * (len(columns) - 1) / (most - 1))] for place in range(most)}
        rows = {key: row for key, row in self.rows.items() if key[1] in kept}
        return replace(self, rows=rows, cut=True)


def main_rows(model: ReportModel) -> list[Estimate]:
    """Return the estimates that the first page shows: of the declared quantities, else all with an uncertainty.

    What another method gives is there to compare with, and stands behind; but for a quantity that no other gives.
    """
    found = model.rows
    method = model.results.get("method")
    named = any(row.conditions.get("method") == method for row in found)  # else a way of the analysis, not of one
    entries = [row for row in found if not named or row.conditions.get("method", method) == method]
    declared = [row for name in model.main for row in _of_quantity(entries, name) or _of_quantity(found, name)]
    return declared or [row for row in entries if row.expanded_uncertainty or not is_sound(row)]


def _of_quantity(rows: Sequence[Estimate], name: str) -> list[Estimate]:
    return [row for row in rows if row.quantity == name]


@dataclass(frozen=True)
class Shown:
    """The main results as the page has room for them; ``rows``: the estimates that are in the tables."""

    blocks: tuple[Block, ...]
    rows: tuple[Estimate, ...]
    notes: tuple[str, ...]


def shown_results(model: ReportModel, words: Texts) -> Shown:
    """Return tables of the main results, and what a reader must know of them."""
    analysis = model.analysis
    grids = [
        _grid(analysis, quantity_title(analysis, name, words.language), rows)
        for name, rows in grouped(main_rows(model), lambda row: str(row.quantity)).items()
    ]
    blocks: list[Block] = []
    shown: list[Estimate] = []
    lines = 0
    for made, rows in (part for alike in _alike(grids) for part in _made(alike, words)):
        lines += len(made.rows) + len(made.foot) + 3
        if lines <= MOST_LINES:
            blocks.append(made)
            shown += rows
    return Shown(tuple(blocks), tuple(shown), tuple(_notes(words, shown, lines > MOST_LINES)))


def _notes(words: Texts, shown: Sequence[Estimate], cut: bool) -> Iterator[str]:
    if not shown:
        yield words("first.results.none")
    if not all(map(is_sound, shown)):
        yield words("first.results.unsound")
    if cut:
        yield words("first.results.further")


def _grid(campaign: str, title: str, rows: Sequence[Estimate]) -> _Grid:
    shapes = grouped(rows, lambda row: frozenset(row.conditions))
    chosen = max(shapes.values(), key=lambda group: (_TEMPERATURE in group[0].conditions, len(group)))
    names = [name for name in chosen[0].conditions if name != MEASURED]
    varying = [name for name in names if len({_plain(row.conditions[name]) for row in chosen}) > 1]
    if "channel" in varying and "kind" in varying:
        varying.remove("kind")
    across = next((name for name in _ACROSS if name in varying), _TEMPERATURE if _TEMPERATURE in names else None)
    down = tuple(name for name in varying if name != across)
    scale, unit = readable(chosen)
    stated = unit != "1" and any(row.value is not None for row in chosen)
    heading = title + (f" / {unit_text(unit)}" if stated else "")
    return _Grid(campaign, heading, scale, down, across, {_place(row.conditions, down, across): row for row in chosen})


def _place(conditions: Mapping[str, Any], down: Sequence[str], across: str | None) -> tuple[Key, Any]:
    key = tuple(_plain(conditions[name]) for name in down)
    if down == ("channel",):
        key += (conditions.get("kind", ""),)
    return key, None if across is None else _plain(conditions[across])


def _plain(value: Any) -> Any:
    return value if isinstance(value, int | float | str) else str(value)


def _ordered(values: Sequence[Any]) -> list[Any]:
    """Return each value once: numbers by size, axes by letter, other words as they come."""
    once = list(dict.fromkeys(values))
    first = [value[0] if isinstance(value, tuple) and value else value for value in once]
    numbers = all(isinstance(value, int | float) for value in first)
    letters = all(isinstance(value, str) and len(value) == 1 for value in first)
    return sorted(once) if numbers or letters else once


def _alike(grids: Sequence[_Grid]) -> list[list[_Grid]]:
    """Return grids that have the same rows, or, of those without, the same columns."""

    def shape(grid: _Grid) -> Key:
        return grid.names, tuple(grid.down), () if grid.down != [()] else tuple(map(str, grid.columns))

    return list(grouped(grids, shape).values())


def _made(grids: Sequence[_Grid], words: Texts) -> Iterator[tuple[Block, list[Estimate]]]:
    if not grids[0].names:
        for start in range(0, len(grids), MOST_ROWS):
            part = grids[start : start + MOST_ROWS]
            yield _list(part, words), [row for grid in part for row in grid.rows.values()]
        return
    with_U = _table(grids, words, True)
    if _width_pt(with_U) <= ROOM_pt:
        yield with_U, _shown(grids)
        return
    together: list[_Grid] = []
    for grid in (grid.thinned(_MOST_ACROSS) for grid in grids):
        if together and _width_pt(_table([*together, grid], words, False)) > ROOM_pt:
            yield _table(together, words, False), _shown(together)
            together = []
        together.append(grid)
    yield _table(together, words, False), _shown(together)


def _shown(grids: Sequence[_Grid]) -> list[Estimate]:
    keys = grids[0].down[:MOST_ROWS]
    return [row for grid in grids for (key, _), row in grid.rows.items() if key in keys]


def _list(grids: Sequence[_Grid], words: Texts) -> Block:
    """Return quantities down, each with its values, k and, where one is judged, the verdict."""
    columns = grids[0].columns
    judged = any(row.verdict != "none" for grid in grids for row in grid.rows.values())
    head = words("first.results.value")
    at = " °C" if grids[0].across == _TEMPERATURE else ""
    values = [head if value is None else _across(words, grids[0], value) + at for value in columns]
    rows = []
    for grid in grids:
        found = [grid.rows.get(((), value)) for value in columns]
        known = [row for row in found if row is not None]
        last = (_verdict(words, known),) if judged else ()
        rows.append((grid.heading, *(_cell(row, grid, True) for row in found), _factors(known), *last))
    headers = (words("column.quantity"), *values, "k", *((words("first.results.verdict"),) if judged else ()))
    return Block(words("first.results.list"), (), headers, tuple(rows))


def _table(grids: Sequence[_Grid], words: Texts, with_u: bool) -> Block:
    """Return rows down and quantities side by side; where U does not stand with the values, it stands below them."""
    keys = grids[0].down
    body, foot, headers = [], [], [_down(words, grids[0])]
    for key in keys[:MOST_ROWS]:
        cells = [_cell(grid.rows.get((key, value)), grid, with_u) for grid in grids for value in grid.columns]
        body.append((_label(words, grids[0], key), *cells))
    below = [[row for (_, at), row in grid.rows.items() if at == value] for grid in grids for value in grid.columns]
    headers += ["" if value is None else _across(words, grid, value) for grid in grids for value in grid.columns]
    if not with_u:
        foot += _below(words, grids, below)
    foot.append(("k", *map(_factors, below)))
    if any(row.verdict != "none" for rows in below for row in rows):
        foot.append((words("first.results.verdict"), *(_verdict(words, rows) for rows in below)))
    groups = (("", 1), *((grid.heading, len(grid.columns)) for grid in grids))
    more = words("first.results.more", shown=MOST_ROWS, all=len(keys)) if len(keys) > MOST_ROWS else ""
    some = words("first.results.columns") if any(grid.cut for grid in grids) else ""
    caption = words("first.results.full" if with_u else "first.results.short")
    return Block(
        " ".join(part for part in (caption, some, more) if part), groups, tuple(headers), tuple(body), tuple(foot)
    )


def _below(words: Texts, grids: Sequence[_Grid], below: Sequence[Sequence[Estimate]]) -> list[tuple[str, ...]]:
    """Return the largest U of each column, for each kind of channel where there are several."""
    kinds = dict.fromkeys(row.conditions.get("kind", "") for rows in below for row in rows)
    scales = [grid.scale for grid in grids for _ in grid.columns]
    lines = []
    for kind in kinds:
        of_kind = [[row for row in rows if row.conditions.get("kind", "") == kind] for rows in below]
        head = words("first.results.U") if len(kinds) == 1 else words("first.results.U_of", kind=kind_of(words, kind))
        lines.append((head, *map(_largest, of_kind, scales)))
    return lines


def _width_pt(block: Block) -> float:
    lines = [block.headers, *block.rows, *block.foot]
    widths = [max(len(line[index]) for line in lines) * _LETTER_pt + _GAP_pt for index in range(len(block.headers))]
    at, total = 0, 0.0
    for heading, count in block.groups:
        total += max(sum(widths[at : at + count]), len(heading) * _LETTER_pt * 0.6 + _GAP_pt)  # may take two lines
        at += count
    return total


def _cell(row: Estimate | None, grid: _Grid, with_u: bool) -> str:
    """Return a value, with its expanded uncertainty or to the digits that this leaves it."""
    if row is None or not is_sound(row) or row.value is None:
        return _unsound(row, grid)
    value, expanded = row.value * grid.scale, row.expanded_uncertainty
    if with_u:
        return with_uncertainty(value, None if expanded is None else expanded * grid.scale)
    return number(value, decimals_for(expanded * grid.scale) if expanded else None)


def _unsound(row: Estimate | None, grid: _Grid) -> str:
    if row is None or row.value is None:
        return "–" if row is None else NOT_SOUND
    value = row.value * grid.scale
    return f"{number(value if grid.places is not None else float(f'{value:.3g}'), grid.places)} {NOT_SOUND}"


def _largest(rows: Sequence[Estimate], scale: float) -> str:
    known = [row.expanded_uncertainty * scale for row in rows if row.expanded_uncertainty]
    return number(max(known), decimals_for(max(known))) if known else "–"


def _factors(rows: Sequence[Estimate]) -> str:
    known = sorted(row.coverage_factor for row in rows if row.expanded_uncertainty)
    if not known:
        return "–"
    low, high = f"{known[0]:.2f}", f"{known[-1]:.2f}"
    return low if low == high else f"{low}–{high}"


def _verdict(words: Texts, rows: Sequence[Estimate]) -> str:
    found = worst(row.verdict for row in rows)
    return "–" if found == "none" else words(f"verdict.{found}")


def _across(words: Texts, grid: _Grid, value: Any) -> str:
    if grid.across == _TEMPERATURE:
        return number(value)
    if isinstance(value, int | float):
        return f"{condition_head(words, str(grid.across), grid.campaign)} {cell(value)}"
    return condition_value(words, str(grid.across), value, grid.campaign)


def _down(words: Texts, grid: _Grid) -> str:
    names = ", ".join(
        condition_head(words, name, grid.campaign, _scale(words, grid, place)[1])
        for place, name in enumerate(grid.names)
    )
    return words("first.results.at", names=names) if grid.across == _TEMPERATURE else names


def _label(words: Texts, grid: _Grid, key: Key) -> str:
    if grid.names == ("channel",):
        return f"{key[0]} {kind_of(words, key[1])}" if key[1] else str(key[0])
    return ", ".join(
        condition_value(words, name, _scaled(key[place], _scale(words, grid, place)[0]), grid.campaign)
        for place, name in enumerate(grid.names)
    )


def _scale(words: Texts, grid: _Grid, place: int) -> tuple[float, str]:
    """Return factor and unit of what goes down at a place of the key."""
    return condition_scale(words, grid.names[place], [key[place] for key in grid.down], grid.campaign)


def _scaled(value: Any, scale: float) -> Any:
    return value if scale == 1.0 else scale * value
