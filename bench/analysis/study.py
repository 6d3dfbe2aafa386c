"""What a system offers to be a study: parts that are computed by themselves, and what is made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from bench.analysis.figures import Figure
from bench.analysis.tables import Table


@dataclass(frozen=True)
class Chapter:
    """Figures, tables and sentences under one heading; ``name`` stands for its title in the texts of the report."""

    name: str
    figures: Sequence[Figure]
    tables: Sequence[Table]
    paragraphs: Sequence[str] = ()


class Task(Protocol):
    """One part of a study, computed by itself."""

    @property
    def name(self) -> str:
        """What a person reads while it runs."""


class Study(Protocol):
    """What a system offers to be a study; its options, its results and their form are its own."""

    def checked_options(self, runs: int | None, seed: int, offsets: str, quick: bool) -> Any:
        """Return the options as a person gives them. Raises: InputError B-STUDY-002."""

    def tasks_of(self, options: Any) -> Sequence[Task]:
        """Return all tasks, the longest first."""

    def run_task(self, task: Any) -> Any:
        """Compute one task; it depends on nothing but the task."""

    def results_of(self, options: Any, gave: Sequence[Any]) -> Any:
        """Put together what the tasks gave, in their order."""

    def study_document(self, options: Any, found: Any, software: str) -> dict[str, Any]:
        """Return the document of the study."""

    def study_json(self, document: Mapping[str, Any]) -> str:
        """Return the text of the document."""

    def study_chapters(self, options: Any, document: Mapping[str, Any], found: Any) -> Sequence[Chapter]:
        """Return the chapters of the page."""
