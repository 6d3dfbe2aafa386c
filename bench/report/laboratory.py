"""The laboratory file: what a calibration report and a certificate state and a session does not know.

An accreditation covers real, sound results within the declared scope, with U not below the calibration and measurement
capability (CMC): a smaller U would claim more than the laboratory was accredited for.

Source: ILAC-P14:09/2020 (reported uncertainties against the CMC); ILAC-P8 (use of the mark).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import date
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StringConstraints, model_validator

from bench.analysis import Estimate, is_sound, number, unit_text
from bench.model.errors import InputError
from bench.model.units import quantity, read_quantity
from bench.model.yamlio import Name, StrictModel, load_yaml
from bench.plan import Date, Stated

LABORATORY_FILE = "laboratory.yaml"  # the copy that a session keeps of the one its report was written with
Words = Annotated[str, StringConstraints(min_length=1, max_length=200, strip_whitespace=True)]
Prose = Annotated[str, StringConstraints(min_length=1, max_length=2000, strip_whitespace=True)]
Number = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._/-]{0,79}$")]
Country = Annotated[str, StringConstraints(pattern=r"^[A-Z]{2}$")]
Temperature = Annotated[float, *quantity("degC", -40.0, 60.0)]
Humidity = Annotated[float, *quantity("1", 0.0, 1.0)]
_EQUAL = 1.0 - 1e-9  # a U that is the CMC itself, computed another way


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
    """What the session does not say of the unit under test; ``state``: in which it came in."""

    name: Words
    manufacturer: Words | None = None
    customer_number: Words | None = None
    state: Words | None = None


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


class Adjustment(StrictModel):
    """An adjustment or repair between two calibrations; ``other``: number of the report with the other results."""

    what: Prose
    results: Literal["as_found", "as_left"]
    other: Number | None = None


class Replaced(StrictModel):
    """The report that an amended one stands for, and why."""

    number: Number
    reason: Prose


class NextCalibration(StrictModel):
    """A day that laboratory and customer agreed on; nobody else may recommend one."""

    day: Date
    agreed: Literal[True]


class Capability(StrictModel):
    """A line of the scope: a quantity of results.json, its values, and the least U that it is accredited for.

    ``cmc``: expanded uncertainty, 95 %, in a unit of the quantity.   ``method``: the analysis.
    """

    quantity: Name
    range: tuple[Stated, Stated]
    cmc: Stated
    method: Name

    @model_validator(mode="after")
    def _one_dimension(self) -> Capability:
        (low, of_low), (high, of_high), (cmc, of_cmc) = *self.range, self.cmc
        if not of_low == of_high == of_cmc:
            raise ValueError(f"range and cmc of {self.quantity} are of different dimensions")
        if low > high:
            raise ValueError("write the lower value first")
        if cmc <= 0.0:
            raise ValueError("a cmc is above zero")
        return self


class Accreditation(StrictModel):
    """Who accredited the laboratory, under which number and for what."""

    body: Words
    number: Words
    scope: list[Capability] = Field(min_length=1)


class Laboratory(StrictModel):
    """A laboratory file."""

    prefix: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,39}$")]
    number: Number | None = Field(None, description="of the report; <prefix>-<name of the session> without it")
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
    adjustment: Adjustment | None = None
    replaces: Replaced | None = None
    next_calibration: NextCalibration | None = None
    accreditation: Accreditation | None = None
    statements: list[Prose] = Field(default_factory=list)

    @model_validator(mode="after")
    def _somebody_signs(self) -> Laboratory:
        if not any(person.signs for person in self.responsible):
            raise ValueError("responsible: nobody signs; give one person 'signs: true'")
        return self

    @model_validator(mode="after")
    def _a_number_of_its_own(self) -> Laboratory:
        if self.replaces is not None and self.number in (None, self.replaces.number):
            raise ValueError("replaces: an amended report needs a 'number' of its own")
        return self

    def number_of(self, session: str) -> str:
        """Return the unique number of a report or certificate of a session."""
        return self.number or f"{self.prefix}-{session}"

    def refuse_other_days(self, where: str, began: date, ended: date) -> None:
        """Refuse an item received after the measurement began, and a report issued before it ended.

        Raises: InputError B-DCC-014.
        """
        wrong = []
        if self.received is not None and self.received > began:
            wrong.append(f"received {self.received}, but the measurement began on {began}")
        if self.issued is not None and self.issued < ended:
            wrong.append(f"issued {self.issued}, but the measurement ended on {ended}")
        if wrong:
            advice = "correct the days in the laboratory file; a certificate without 'issued' is of today"
            raise InputError("B-DCC-014", "; ".join(wrong), where=where, next_step=advice)


def load_laboratory(path: Path) -> Laboratory:
    """Read a laboratory file. Raises: InputErrors (B-YAML-...) with every mistake and its place."""
    return load_yaml(path, Laboratory).model


def laboratory_of(session: Path) -> Laboratory | None:
    """Return the laboratory that a session's report was written with, None without one. Raises: as above."""
    path = session / LABORATORY_FILE
    return load_laboratory(path) if path.is_file() else None


def not_covered(accreditation: Accreditation, method: str, rows: Iterable[Estimate]) -> dict[str, str]:
    """Return why results may not be stated under an accreditation, by quantity; {} if all may.

    Args: method: the analysis that gave them.   rows: entries of results.json.
    """
    by_quantity: dict[str, list[str]] = {}
    for row in rows:
        reason = _reason(accreditation.scope, method, row)
        if reason:
            by_quantity.setdefault(str(row.quantity), []).append(reason)
    return {
        quantity: reasons[0] + (f", and {len(reasons) - 1} more of it" if len(reasons) > 1 else "")
        for quantity, reasons in by_quantity.items()
    }


def below_capability(accreditation: Accreditation, method: str, rows: Iterable[Estimate]) -> dict[str, str]:
    """Return only those of the reasons that are an uncertainty below the CMC of a result within the scope."""
    within = [row for row in rows if is_sound(row) and _matching(accreditation.scope, method, row)]
    return not_covered(accreditation, method, within)


def _reason(scope: Sequence[Capability], method: str, row: Estimate) -> str:
    if not is_sound(row):
        return f"is {row.quality}"
    lines = _matching(scope, method, row)
    if not lines:
        return f"{number(row.value)} {unit_text(row.unit)} by {method} is outside the scope"
    expanded = row.expanded_uncertainty or 0.0
    least = min(line.cmc[0] for line in lines) / _factor(row.unit)
    if expanded >= least * _EQUAL:
        return ""
    unit = unit_text(row.unit)
    return f"U = {number(float(f'{expanded:.3g}'))} {unit} is below the CMC of {number(float(f'{least:.6g}'))} {unit}"


def _matching(scope: Sequence[Capability], method: str, row: Estimate) -> list[Capability]:
    """Return the lines of the scope that a result falls under; none if its unit is not one that a scope can state."""
    unit = read_quantity(f"1 {row.unit}")
    if unit is None or row.value is None:
        return []
    value = float(row.value) * unit[0]
    return [
        line
        for line in scope
        if (line.quantity, line.method, line.cmc[1]) == (row.quantity, method, unit[1])
        and line.range[0][0] <= value <= line.range[1][0]
    ]


def _factor(unit: str) -> float:
    known = read_quantity(f"1 {unit}")
    assert known is not None
    return known[0]
