"""The tables of tests/doubt/tables.md, from the rows of one revision, and what they must not show."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

from block_rows import ROOT
from doubt_blocks import Bias, Block

PAGE = ROOT / "tests" / "doubt" / "tables.md"
BELOW = "<!-- Everything below is written by `make doubt`. -->"
_DRAWN = "departures"  # worlds of a table and drawn ones: rows.csv alone has them
MOST_DOUBTED = 0.01  # of right campaigns: designed for 0.2 %, five of 500 are what chance may bring
_COUNTS = ("right", "wide", "missed", "doubted", "refused", "confidently_wrong")


def with_tables(page: str, rows: Sequence[Block], biases: Sequence[Bias]) -> str:
    """Return the page with the tables of these rows below its mark."""
    head, mark, _ = page.partition(BELOW)
    assert mark, f"{PAGE.name} has no mark below which tables stand"
    revisions = ", ".join(sorted({row.revision for row in rows}))
    cpu_s = sum(row.cpu_s for row in rows)
    lines = [mark, "", f"Revision {revisions}, {cpu_s:.0f} s of CPU. Bias: of the worst estimate without noise, in U."]
    for system in sorted({row.system for row in rows} - {_DRAWN}):
        lines += ["", f"## {system}", "", *_table([row for row in rows if row.system == system], biases)]
    return head + "\n".join(lines) + "\n"


def faults_of(rows: Sequence[Block], assumptions: Mapping[str, str]) -> list[str]:
    """Return what must not be, a sentence each; ``assumptions``: what names a switch where no data can show it."""
    faults = []
    for row in _summed(rows):
        unnamed = 0 if assumptions.get(row.switch) else row.confidently_wrong - row.visible
        for count, why in (row.visible, "it could have been seen"), (unnamed, "no assumption names it"):
            if count:
                faults.append(f"{row.system}, {row.switch} {row.size:g}: {count} confidently wrong, and {why}")
        if not row.switch and row.campaigns > MOST_DOUBTED * len(row.seeds):
            faults.append(f"{row.system}: {row.campaigns} of {len(row.seeds)} right campaigns are doubted")
    return faults


def _summed(rows: Sequence[Block]) -> list[Block]:
    """Return one row for each switch and size, right worlds included."""
    groups: dict[tuple[str, str, float], list[Block]] = defaultdict(list)
    for row in rows:
        groups[row.system, row.switch, row.size].append(row)
    return [_sum(group) for group in groups.values()]


def _sum(group: Sequence[Block]) -> Block:
    counts = {name: sum(getattr(row, name) for row in group) for name in (*_COUNTS, "visible", "campaigns")}
    seeds = sum(len(row.seeds) for row in group)
    largest = {name: max(getattr(row, name) for row in group) for name in ("trace", "bias")}
    first = group[0]
    cpu_s = sum(row.cpu_s for row in group)
    return Block(first.system, first.switch, first.size, 0, seeds - 1, first.revision, **largest, **counts, cpu_s=cpu_s)


def _table(rows: Sequence[Block], biases: Sequence[Bias]) -> list[str]:
    heads = ["switch", "size", "trace", "bias", *(name.replace("_", " ") for name in _COUNTS), "most off"]
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for row in sorted(_summed(rows), key=lambda row: (row.switch or "~", row.size)):
        counts = [str(getattr(row, name)) for name in _COUNTS]
        if not row.switch:
            told = f"{row.campaigns} of {len(row.seeds)} campaigns doubted"
            lines.append(f"| *right worlds* | | | | {' | '.join(counts)} | {told} |")
            continue
        hidden = " (hidden)" if row.hidden else ""
        of_it = [bias for bias in biases if (bias.system, bias.switch, bias.size) == (row.system, row.switch, row.size)]
        most = max(of_it, key=lambda bias: bias.worst, default=None)
        cells = [row.switch, f"{row.size:g}", f"{row.trace:g}{hidden}", f"{row.bias:g}", *counts]
        lines.append(f"| {' | '.join(cells)} | {most.quantity if most and most.worst > 0 else '–'} |")
    return lines
