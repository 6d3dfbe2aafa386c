"""A certificate is made of a finished session, checked results, and the laboratory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints, model_validator

from bench.model.texts import Texts
from bench.model.units import quantity
from bench.model.yamlio import StrictModel, load_yaml
from bench.plan import Date

TEXTS = Texts(Path(__file__).parent)
SPECIMEN = "SPECIMEN"
ITEM_ID = "item_1"
Words = Annotated[str, StringConstraints(min_length=1, max_length=200, strip_whitespace=True)]
Prose = Annotated[str, StringConstraints(min_length=1, max_length=2000, strip_whitespace=True)]
Country = Annotated[str, StringConstraints(pattern=r"^[A-Z]{2}$")]
Temperature = Annotated[float, *quantity("degC", -40.0, 60.0)]
Humidity = Annotated[float, *quantity("1", 0.0, 1.0)]


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

    @property
    def simulated(self) -> bool:
        """True unless the results say that a real bench was measured."""
        return self.results.get("provenance", {}).get("simulated") is not False

    @property
    def unique_identifier(self) -> str:
        """Prefix of the laboratory and name of the session; a specimen says so first."""
        name = f"{self.laboratory.prefix}-{self.results['session']}"
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


class Contact(StrictModel):
    """A laboratory, a customer or a maker with its address; country as two capital letters (ISO 3166-1)."""

    name: Words
    country: Country
    city: Words
    post_code: Words | None = None
    street: Words | None = None
    street_number: Words | None = None
    e_mail: Words | None = None
    phone: Words | None = None


class LaboratoryContact(Contact):
    """The calibration laboratory; ``code``: its accreditation or registration number."""

    code: Words | None = None


class Item(StrictModel):
    """What the session does not say of the unit under test."""

    name: Words
    manufacturer: Words | None = None
    customer_number: Words | None = None


class Person(StrictModel):
    """Somebody responsible for the certificate."""

    name: Words
    role: Words | None = None
    signs: bool = False


class Surroundings(StrictModel):
    """Between which values the laboratory was kept, as it monitors them."""

    temperature: tuple[Temperature, Temperature]
    humidity: tuple[Humidity, Humidity] | None = None

    @model_validator(mode="after")
    def _in_order(self) -> Surroundings:
        for pair in (self.temperature, self.humidity):
            if pair is not None and pair[0] > pair[1]:
                raise ValueError("write the lower value first")
        return self


class Laboratory(StrictModel):
    """A laboratory file."""

    prefix: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,39}$")]
    laboratory: LaboratoryContact
    customer: Contact
    item: Item
    responsible: list[Person] = Field(min_length=1)
    traceability: Prose
    surroundings: Surroundings
    location: Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] = "laboratory"
    order: Words | None = None
    received: Date | None = None
    issued: Date | None = None
    statements: list[Prose] = Field(default_factory=list)

    @model_validator(mode="after")
    def _somebody_signs(self) -> Laboratory:
        if not any(person.signs for person in self.responsible):
            raise ValueError("responsible: nobody signs; give one person 'signs: true'")
        return self


def load_laboratory(path: Path) -> Laboratory:
    """Read a laboratory file. Raises: InputErrors (B-YAML-...) with every mistake and its place."""
    return load_yaml(path, Laboratory).model
