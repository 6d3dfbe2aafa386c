"""The sentences on what a session holds, read again, by key (texts/en.json)."""

from __future__ import annotations

from pathlib import Path

from bench.model.texts import Sayings

say = Sayings(Path(__file__).parent)
