"""A certificate is made of a finished session, checked results, and the laboratory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from functools import cached_property
from pathlib import Path
from typing import Any

from bench.analysis import Estimates, estimates_of
from bench.model.texts import Texts
from bench.report.laboratory import Laboratory

FOLDER = Path(__file__).parent
TEXTS = Texts(FOLDER)
SPECIMEN = "SPECIMEN"
ITEM_ID = "item_1"


@dataclass(frozen=True)
class Span:
    """Lowest and highest of something, degC."""

    low_degC: float
    high_degC: float


@dataclass(frozen=True)
class Calibration:
    """A calibration to certify.

    ``results``: the document of results.json; ``manifest``: that of the session; ``began``, ``ended``: UTC days.
    ``hashes``: name (session, results, report) -> SHA-256; ``chamber``, ``unit``: temperatures during the campaign.
    ``issued``: day of issue, None leaves it out; ``specimen``: marked as no calibration.
    """

    results: Mapping[str, Any]
    manifest: Mapping[str, Any]
    laboratory: Laboratory
    hashes: Mapping[str, str]
    began: date
    ended: date
    issued: date | None = None
    specimen: bool = False
    chamber: Span | None = None
    unit: Span | None = None

    @cached_property
    def estimates(self) -> Estimates:
        """The estimates of the results."""
        return estimates_of(self.results)

    @property
    def simulated(self) -> bool:
        """True unless the results say that a real bench was measured."""
        return self.results.get("provenance", {}).get("simulated") is not False

    @property
    def unique_identifier(self) -> str:
        """Number that the laboratory gives it; a specimen says so first."""
        name = self.laboratory.number_of(str(self.results["session"]))
        return f"{SPECIMEN}-{name}" if self.specimen else name

    def marked(self, title: str) -> str:
        """Return a title as it is printed: that of a specimen says in words that it is no certificate."""
        if not self.specimen:
            return title
        mark = TEXTS("mark.simulated" if self.simulated else "mark.specimen")
        return f"{mark}: {title}"


def nobody() -> Laboratory:
    """Return the laboratory of a specimen for which none is named."""
    contact = {"name": TEXTS("nobody.laboratory"), "country": "ZZ", "city": TEXTS("nobody.city")}
    return Laboratory.model_validate(
        {
            "prefix": "NONE",
            "laboratory": contact,
            "customer": {**contact, "name": TEXTS("nobody.customer")},
            "item": {"name": TEXTS("nobody.item")},
            "responsible": [{"name": TEXTS("nobody.person"), "signs": True}],
            "traceability": TEXTS("nobody.traceability"),
            "surroundings": {"temperature": ["22 degC", "24 degC"]},
        }
    )
