"""Tables of an analysis before any rendering: cells are words and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Table:
    """A table with its caption; ``prose``: its cells are words, ``lead``: it is read first."""

    title: str
    caption: str
    headers: Sequence[str]
    rows: Sequence[Sequence[Any]]
    prose: bool = False
    lead: bool = False
