"""What a reader of a report must not meet: the names of the code, and an interval that no estimate states."""

from __future__ import annotations

import math
import re

from bench.analysis import with_uncertainty
from bench.session.fitted import Shown

_UNITS = (1.0, 1e2, 1e3, 1e6, 3600.0, 3.6e6, math.sqrt(0.5), 6400.0 / 360.0)  # that tables use beside results.json
_CODE_NAME = re.compile(r"(?<![\w/.])[a-z][a-z0-9]*(?:_[a-z0-9]+)+(?![\w/.])")


def code_names(page: str) -> set[str]:
    """Return words with underscores that a reader sees, but for what names files: the sequence, software and hashes."""
    seen = re.sub(r"<(style|section id=\"provenance\").*?</(style|section)>", "", page, flags=re.DOTALL)
    return set(_CODE_NAME.findall(re.sub(r"<[^>]*>|Sequence \w+,", " ", seen)))


def intervals_of_tables_alone(shown: Shown) -> set[str]:
    """Return what tables of an analysis state as value ± U that is no estimate with its expanded uncertainty."""
    stated = {
        with_uncertainty(unit * entry["value"], unit * entry["expanded_uncertainty"])
        for entry in shown.results["estimates"]
        if entry["expanded_uncertainty"]
        for unit in _UNITS
    }
    cells = {cell for table in shown.analysis.tables for row in table.rows for cell in row if "±" in str(cell)}
    return {cell.replace("-", "−").removesuffix(" WORSE") for cell in cells} - stated
