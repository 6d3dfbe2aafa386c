"""The sentences on a time offset, by key (texts/en.json)."""

from __future__ import annotations

from pathlib import Path

from bench.model.texts import Sayings

say = Sayings(Path(__file__).parent)


def filter_name(name: str) -> str:
    """Return the name of a filter for people."""
    return say(f"filter.{name}")


def headers_of(table: str, *names: str) -> list[str]:
    """Return the heads of a table."""
    return [say(f"{table}.head.{name}") for name in names]
