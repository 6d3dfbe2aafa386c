"""The sentences on the run of a session, by key (texts/en.json)."""

from pathlib import Path

from bench.model.texts import Sayings

say = Sayings(Path(__file__).parent)
