"""The page of a study: one self-contained HTML document of its chapters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.analysis import Chapter
from bench.model.texts import ENGLISH, Texts
from bench.report.html import page
from bench.report.plots.graphs import analysis_pictures
from bench.report.sections import Section
from bench.report.tables import analysis_tables, sentence
from bench.report.words import words_of


def study_html(document: Mapping[str, Any], chapters: Sequence[Chapter], software: str, language: str = ENGLISH) -> str:
    """Return the page; the same study gives the same bytes in the same environment, no date and no random id enters.

    Args: document: of study.json, with ``study``, ``runs``, ``seed`` and ``estimates``.
    """
    words = words_of(language)
    name = str(document["study"])
    subtitle = words("study.subtitle", runs=document["runs"], seed=document["seed"], software=software)
    sections = [section for section in _sections(name, chapters, words) if section]
    return page(
        words(f"study.title.{name}"), subtitle, sections, words, verdict=_verdict(document, words), simulated=True
    )


def _verdict(document: Mapping[str, Any], words: Texts) -> tuple[str, str]:
    verdicts = [one["verdict"] for one in document["estimates"] if one["verdict"] != "none"]
    failed = verdicts.count("fail")
    kind = "fail" if failed else "pass" if verdicts else "none"
    return kind, words("study.verdict", kept=len(verdicts) - failed, failed=failed)


def _sections(name: str, chapters: Sequence[Chapter], words: Texts) -> list[Section]:
    figures = [(chapter.name, figure) for chapter in chapters for figure in chapter.figures]
    pictures = analysis_pictures([figure for _, figure in figures])  # all at once: each gets a name of its own
    groups = dict.fromkeys((place, figure.group) for place, figure in figures)
    placed = list(zip(groups, pictures, strict=True))
    return [
        Section(
            chapter.name,
            words(f"study.{name}.{chapter.name}"),
            tuple(map(sentence, chapter.paragraphs)),
            tuple(analysis_tables(chapter.tables)),
            tuple(drawn for (place, _), drawn in placed if place == chapter.name),
        )
        for chapter in chapters
    ]
