"""The page: sections of text, tables and figures in one self-contained HTML document."""

from __future__ import annotations

from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from bench.model.texts import Texts
from bench.report.model import ReportModel
from bench.report.sections import Section
from bench.report.verdict_tables import overall_verdict

TEMPLATES = Path(__file__).parent / "templates"


def html_page(model: ReportModel, sections: list[Section], words: Texts) -> str:
    """The report as one HTML document that needs no other file, no network and no script.

    The same model gives the same bytes in the same environment; no date and no random id enters.
    """
    session, verdict = str(model.results["session"]), overall_verdict(model, words)
    return page(model.title, session, sections, words, verdict=verdict, simulated=model.simulated)


def page(
    title: str, subtitle: str, sections: list[Section], words: Texts, *, verdict: tuple[str, str], simulated: bool
) -> str:
    """Sections as one HTML document; ``verdict``: class (none, pass, fail) and words."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("report.html.j2").render(
        title=title,
        subtitle=subtitle,
        sections=sections,
        words=words,
        language=words.language,
        watermark=words("watermark") if simulated else "",
        verdict=verdict,
    )
