"""The mapping language: what the columns of a delimited log of another system mean (docs/importing.md)."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from functools import cache, reduce
from operator import or_
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import (
    AfterValidator,
    Field,
    ModelWrapValidatorHandler,
    StringConstraints,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import InitErrorDetails

from bench.model.declaration import LogColumn, LogSections, System
from bench.model.lab import refuse_other_kinds
from bench.model.systems import analysis_declaration, fields_of, sections_in, systems, systems_named, with_sections
from bench.model.units import quantity, read_quantity
from bench.model.yamlio import Document, Name, StrictModel, characters, load_yaml

UnitName = Annotated[str, characters(80)]
Header = Annotated[str, characters(200)]
Role = Literal["temperature", "set_point", "reading", "reference"]
ELAPSED, UNIX, ISO, SAMPLES, ROWS = "elapsed", "unix", "iso", "samples", "rows"
TEMPERATURES = ("temperature", "set_point")
_NUMBERS = re.compile(r"\{(\d{1,6})\.\.(\d{1,6})\}")
_MOST = 4000  # columns that differ by a number
_PROBE = datetime(2001, 12, 23, 21, 43, 56)
_ZONE = r"^(UTC|[+-](0[0-9]|1[0-4]):[0-5][0-9])$"
_OF_ANY = ("time", "temperature", "ignore")  # roles that an analysis of logs need not name


def _unit(text: str) -> str:
    if read_quantity(f"1 {text}") is None:
        raise ValueError(f"{text!r} is no unit; write one such as V, mV, uA, ohm, degC or ppm")
    return text


def _second(text: str) -> str:
    duration = read_quantity(text) or read_quantity(f"1 {text}")
    if duration is None or duration[1] != "s" or duration[0] <= 0.0:
        raise ValueError(f"{text!r} is no unit of time; write s, ms, min or h, or a tick such as 0.1 ms")
    return text


def _time_format(text: str) -> str:
    """A word of the language, or a pattern that tells one second of one day from any other."""
    if text in (ELAPSED, UNIX, ISO, SAMPLES, ROWS):
        return text
    if "%" not in text:
        raise ValueError(
            f"{text!r} is neither iso, unix, elapsed, samples, rows nor a pattern such as '%d/%m/%Y %H:%M:%S'"
        )
    try:
        read = datetime.strptime(_PROBE.replace(tzinfo=UTC).strftime(text), text).replace(tzinfo=None)
    except ValueError as error:
        raise ValueError(f"{text!r} is no pattern that can be read: {error}") from error
    if read != _PROBE:
        raise ValueError(f"{text!r} does not tell date and time to the second; {_PROBE} would be read as {read}")
    return text


def _instant(text: str) -> str:
    try:
        known = datetime.fromisoformat(text).tzinfo is not None
    except ValueError as error:
        raise ValueError(f"{text!r} is no time such as 2024-10-20T01:18:45+00:00") from error
    if not known:
        raise ValueError(f"{text!r} has no zone; end it with Z or an offset such as +02:00")
    return text


class TimeColumn(StrictModel):
    """The column that says when a row was taken."""

    role: Literal["time"]
    format: Annotated[str, AfterValidator(_time_format)] = Field(
        description="iso, unix (since 1970), elapsed (since 'start'), samples (numbered, at a 'rate', since 'start'), "
        "rows (one sample a row at a 'rate', since 'start', whatever the column holds), "
        "or a strptime pattern such as '%d/%m/%Y %H:%M:%S'"
    )
    unit: Annotated[str, AfterValidator(_second)] | None = Field(
        None, description="of unix and elapsed times, or their tick, such as 0.1 ms"
    )
    zone: Annotated[str, StringConstraints(pattern=_ZONE)] | None = Field(
        None, description="UTC or an offset such as +02:00; of iso times and patterns without %z"
    )
    start: Annotated[str, AfterValidator(_instant)] | None = Field(
        None, description="UTC of the elapsed time 0 or of sample 0, such as 2024-10-20T01:18:45Z"
    )
    rate: Annotated[float, *quantity("Hz", 1e-6, 1e6)] | None = Field(
        None, description="of samples and rows, as the recorder states it, such as 102.4 Hz"
    )

    @model_validator(mode="after")
    def _complete(self) -> TimeColumn:
        numeric, numbered = self.format in (ELAPSED, UNIX), self.format in (SAMPLES, ROWS)
        due = {
            "unit": numeric,
            "start": self.format == ELAPSED or numbered,
            "zone": not numeric and not numbered and "%z" not in self.format,
            "rate": numbered,
        }
        for key, wanted in due.items():
            if wanted != (getattr(self, key) is not None):
                verb = "needs" if wanted else "takes no"
                raise ValueError(f"the time format {self.format!r} {verb} {key!r}")
        return self

    @property
    def offset_s(self) -> float:
        """Seconds that the zone is ahead of UTC."""
        if self.zone in (None, "UTC"):
            return 0.0
        sign, hours, minutes = self.zone[0], int(self.zone[1:3]), int(self.zone[4:6])
        return (-1 if sign == "-" else 1) * timedelta(hours=hours, minutes=minutes).total_seconds()


class ValueColumn(LogColumn):
    """A column of numbers that is read."""

    role: Role
    quantity: Name = Field(description="its name in results and reports")
    unit: Annotated[str, AfterValidator(_unit)] = Field(description="of the numbers in the file")


class IgnoredColumn(StrictModel):
    """A column that is known and not read."""

    role: Literal["ignore"]


Column = TimeColumn | LogColumn | IgnoredColumn
_COLUMNS: tuple[type[StrictModel], ...] = (TimeColumn, ValueColumn, IgnoredColumn)


class FileForm(StrictModel):
    """How the file is written."""

    delimiter: Annotated[str, StringConstraints(pattern=r'^([^"\r\n0-9.+-]|whitespace)$')] = Field(
        ",", description='one character, "\\t" for a tab, or whitespace for runs of blanks and tabs'
    )
    header: int | None = Field(None, ge=1, le=10_000, description="line of the column names; default: the first one")
    names: Annotated[list[Header], Field(min_length=1, max_length=1000)] | None = Field(
        None, description="names of the columns of a file that has no line with them, or in place of its 'header'"
    )
    decimal: Literal[".", ","] = "."
    comment: Annotated[str, characters(10)] | None = Field(None, description="lines that begin with this are skipped")
    encoding: Literal["utf-8", "latin-1"] = "utf-8"
    topic: Header | None = Field(
        None, description="of an MCAP file or a ROS bag, such as /sensor; default: the only one"
    )

    @model_validator(mode="after")
    def _consistent(self) -> FileForm:
        if self.decimal == self.delimiter:
            raise ValueError(f"{self.decimal!r} cannot be both decimal sign and delimiter")
        if self.names is not None and len(set(self.names)) < len(self.names):
            raise ValueError("two of the 'names' are the same")
        return self


class Overload(StrictModel):
    """Marks an instrument writes when it could not measure; such values are left out and counted."""

    at_least: float | None = Field(None, gt=0, description="magnitude from which a number is a sentinel")
    values: list[str | int | float] = Field(default_factory=list, description="sentinels, numbers or texts such as OL")


class UnitOfLog(StrictModel):
    """Whose log it is."""

    model: UnitName
    serial: UnitName


class LogMapping(StrictModel):
    """One kind of delimited log; the systems that are installed add their columns and sections."""

    mapping: Name
    title: Annotated[str, StringConstraints(max_length=200)] = ""
    uut: UnitOfLog
    analysis: Name = "none"
    reference_temperature: Annotated[float, *quantity("degC", -273.15, 1000.0)] = 20.0
    file: FileForm = Field(default_factory=lambda: FileForm.model_validate({}))
    columns: dict[Header, Column]
    overload: Overload = Field(default_factory=lambda: Overload.model_validate({}))
    bad_rows: Annotated[float, *quantity("1", 0.0, 1.0)] = Field(
        0.0, description="share of rows that may be unreadable before the file is refused, such as '1 %'"
    )

    @model_validator(mode="wrap")
    @classmethod
    def _roles_are_named(cls, tree: Any, handler: ModelWrapValidatorHandler[LogMapping]) -> LogMapping:
        try:
            return handler(tree)
        except ValidationError as error:
            raise _naming_roles(error, tree) from error

    @model_validator(mode="after")
    def _columns_fit_together(self) -> LogMapping:
        times = [header for header, column in self.columns.items() if column.role == "time"]
        if len(times) != 1:
            raise ValueError(f"{len(times)} columns have the role time, one is due")
        header, time = self.time
        if self.counts_rows and self.bad_rows:
            raise ValueError("'rows' and segments count rows, so no row may be left out; remove 'bad_rows'")
        others = [name for name in self.columns if name not in self._stated]
        due = [name for name in (*others, *self.values) if name != header or time.format != ROWS]
        if self.file.names is not None and (absent := [name for name in due if name not in self.file.names]):
            raise ValueError(f"the column {absent[0]!r} is not among the 'names' of the file")
        names = Counter(column.quantity for column in self.values.values())
        if twice := [name for name, count in names.items() if count > 1]:
            raise ValueError(f"two columns have the quantity {twice[0]!r}")
        self._check_units()
        _check_roles(self.analysis, self.values)
        for sections in sections_in(self, LogSections):
            sections.check_log(self, self)  # type: ignore[arg-type]
        self._check_analysis()
        return self

    def _check_analysis(self) -> None:
        roles = {column.role for column in self.values.values()}
        checked = {"none", *(name for sections in sections_in(self, LogSections) for name in sections.analyses)}
        if self.analysis not in checked and not {"temperature", "reading"} <= roles:
            raise ValueError(f"the analysis {self.analysis!r} needs a column of the roles temperature and reading each")

    def _check_units(self) -> None:
        for header, column in self.values.items():
            if column.role in TEMPERATURES and column.dimension != "degC":
                raise ValueError(f"column {header!r}: the role {column.role} needs the unit degC, not {column.unit!r}")
        references = {column.dimension for column in self.values.values() if column.role == "reference"}
        compared = references | {column.dimension for column in self.values.values() if column.role == "reading"}
        if references and len(compared) > 1:
            raise ValueError(f"readings and references have different units: {', '.join(sorted(compared))}")

    @property
    def time(self) -> tuple[str, TimeColumn]:
        """Header and description of the column of time."""
        return next((header, column) for header, column in self.columns.items() if isinstance(column, TimeColumn))

    @property
    def values(self) -> Mapping[str, LogColumn]:
        """Columns of numbers, by header; each of those that differ by a number for itself."""
        return {name: column for header, stated in self._stated.items() for name, column in _each(header, stated)}

    @property
    def _stated(self) -> Mapping[str, LogColumn]:
        return {header: column for header, column in self.columns.items() if isinstance(column, LogColumn)}

    @property
    def rate_Hz(self) -> float | None:
        """Rate of samples that are numbered."""
        return self.time[1].rate

    @property
    def counts_rows(self) -> bool:
        """Whether the number of a row says what it is, by the time format or by segments: none may be left out."""
        return self.time[1].format == ROWS or self.beyond(0) is not None

    def campaign(self) -> dict[str, Any]:
        """Return the section ``campaign`` of the manifest of an imported session."""
        document = {
            "analysis": self.analysis,
            "reference_temperature_degC": self.reference_temperature,
            "uut": {"model": self.uut.model, "serial": self.uut.serial},
            "columns": [_column(header, column) for header, column in self._stated.items()],
        }
        for sections in sections_in(self, LogSections):
            document |= sections.log_constants(self, self)  # type: ignore[arg-type]
        return document

    def beyond(self, rows: int) -> tuple[tuple[str, ...], str, str] | None:
        """Return what lies outside of a log of so many rows: its place, what is wrong, what to do; else None."""
        outside = [sections.beyond(self, rows) for sections in sections_in(self, LogSections)]  # type: ignore[arg-type]
        return next((place for place in outside if place is not None), None)


def _due_roles(analysis: object) -> tuple[str, ...]:
    """Return the roles that columns may play for an analysis of logs; empty where any may."""
    declared = analysis_declaration(analysis) if isinstance(analysis, str) else None
    return () if declared is None or not declared.roles else tuple(dict.fromkeys((*declared.roles, *_OF_ANY)))


def _check_roles(analysis: str, values: Mapping[str, LogColumn]) -> None:
    """Refuse a column whose role is one of other analyses only. Raises: ValueError."""
    roles = _due_roles(analysis)
    for header, column in values.items():
        if roles and column.role not in roles:
            raise ValueError(
                f"column {header!r}: {column.role!r} is no role of the analysis {analysis!r}; it takes: "
                f"{', '.join(roles)}"
            )


def _naming_roles(error: ValidationError, tree: object) -> ValidationError:
    """Return the same mistakes of a mapping; where a role is unknown, the due ones are those of its analysis."""
    roles = _due_roles(tree.get("analysis") if isinstance(tree, Mapping) else None)
    details = []
    for item in error.errors(include_url=False):
        context: dict[str, Any] = dict(item.get("ctx", {}))
        if item["type"] == "union_tag_invalid" and roles:
            context["expected_tags"] = ", ".join(map(repr, roles))
        details.append(InitErrorDetails(type=item["type"], loc=item["loc"], input=item["input"], ctx=context))
    return ValidationError.from_exception_data(error.title, details)


def _each(header: str, column: LogColumn) -> list[tuple[str, LogColumn]]:
    """Return headers and columns that an entry stands for. Raises: ValueError for numbers that are missing."""
    if not column.numbered:
        return [(header, column)]
    if (place := _NUMBERS.search(header)) is None or not 0 <= int(place[2]) - int(place[1]) < _MOST:
        raise ValueError(
            f"column {header!r}: the role {column.role} needs the numbers of its columns, first to last and {_MOST} at "
            "most, such as 'sample_{0..423}'"
        )
    before, behind = header[: place.start()], header[place.end() :]
    numbers = range(int(place[1]), int(place[2]) + 1)
    return [(f"{before}{number}{behind}", column.of_number(at)) for at, number in enumerate(numbers)]


def mapping_model() -> type[LogMapping]:
    """Return the language with the columns and sections of all systems that can be used.

    Raises: InstallationError B-PKG-001 if two systems declare one section.
    """
    return _language(*_parts(systems()))


def language_of_mapping(tree: object) -> type[LogMapping]:
    """Return the language of one mapping: with what the bench has and the foreign systems that it names declare.

    Args:   tree: plain values of its file.
    Raises: InstallationError B-PKG-001 if two systems declare one section, or as ``systems_named``.
    """
    stated = tree if isinstance(tree, dict) else {}
    columns = stated.get("columns")
    each = columns.values() if isinstance(columns, dict) else ()
    roles = {column.get("role") for column in each if isinstance(column, dict)}
    engine = {*LogMapping.model_fields, *(role for column in _COLUMNS for role in _roles(column))}
    names = {name for name in (*stated, *roles) if isinstance(name, str)}
    return _language(*_parts(systems_named(stated.get("analysis"), names - engine, _names_of)))


def _roles(column: type[StrictModel]) -> tuple[str, ...]:
    return get_args(column.model_fields["role"].annotation)


def _names_of(system: System) -> set[str]:
    """Return the keys and the roles of columns that a system declares."""
    return {*fields_of(system.log), *(role for column in system.log_columns for role in _roles(column))}


def _parts(systems: Iterable[System]) -> tuple[tuple[type[LogSections], ...], tuple[type[LogColumn], ...]]:
    systems = tuple(systems)
    sections = tuple(system.log for system in systems if system.log is not None)
    return sections, tuple(column for system in systems for column in system.log_columns)


@cache
def _language(sections: tuple[type[LogSections], ...], offered: tuple[type[LogColumn], ...]) -> type[LogMapping]:
    column: Any = reduce(or_, [TimeColumn, ValueColumn, *offered, IgnoredColumn])
    columns: Any = (dict[Header, Annotated[column, Field(discriminator="role")]], ...)
    bases = with_sections(LogMapping, sections)
    made = create_model("LogMapping", __base__=bases, __doc__="One kind of delimited log.", columns=columns)
    assert issubclass(made, LogMapping)
    return made


def _column(header: str, column: LogColumn) -> dict[str, str]:
    return {"header": header, "name": column.quantity, "role": column.role, "unit": column.dimension, **column.more()}


def load_mapping(path: Path) -> Document[LogMapping]:
    """Read and check a mapping file.

    Raises: InputErrors with every mistake and its position; InputError B-SHIP-002 for a file of another kind.
    """
    refuse_other_kinds("mappings", path)
    return load_yaml(path, language_of_mapping)
