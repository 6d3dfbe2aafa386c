"""The declaration of a system, so that the engine need not name it: plain values, nothing of its analyses loaded.

Each system has a module ``declaration`` with a ``DECLARATION``. What is named there as text, ``package.module`` or
``package.module:function``, is imported when it is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, TypeVar

from pydantic import Field, PrivateAttr

from bench.model.units import read_quantity
from bench.model.yamlio import StrictModel

_Stated = TypeVar("_Stated")
MadeOf = Literal["records", "samples", "readings", "values", "tests", "logs"]


@dataclass(frozen=True)
class Limit:
    """A limit that a data sheet may state: its base unit, and whether it must be above zero."""

    dimension: str
    above_zero: bool = False


@dataclass(frozen=True)
class Rule:
    """A rule for the conditions of each record: ``fixed`` values, ``absent`` names; ``asks`` says it in words."""

    fixed: Mapping[str, str]
    absent: tuple[str, ...]
    asks: str
    cure: str


@dataclass(frozen=True)
class AnalysisDeclaration:
    """One analysis.

    ``made_of``: "values" are all that instruments return to steps and records, and that a person gives.
    ``module``: it has ``METHODS`` and ``analyse``.   ``conditions``: what each measuring record must state; ``fields``:
    of its samples; ``conditions_of_open``: what one with an open input must, None for the same.   ``words``: what a
    condition may be.
    ``reading``: action whose readings it needs.   ``items``: test items it judges, ``page`` describes them.
    ``beside``: link whose samples it needs beside those recorded.   ``of_unit``, ``of_channel``: what the data sheet
    must state of the unit, and of each kind of channel.   ``main``: quantities that are shown while it is recorded and
    on the first page of its report.
    ``sizes``: quantities that are never negative, such as an uncertainty: a limit of one is its greatest value.
    ``standards``: roles of the standards whose relative error enters a quantity one to one, by quantity.
    ``problems``: function that says of each record why the analysis leaves it out; "" for what holds for all records.
    ``assumptions``: function that names what its data cannot show, from the section "campaign" of a plan.
    ``predicted``: function that gives the estimates of planned records with the uncertainties they will have;
    ``predicts_long``: it takes longer than all else that a check does, so that it must be asked for.
    ``point``: module that says how well the mean of a measuring point is known (``bench.model.stopping``).
    ``design``: function that says what of a campaign is free, so that the shortest one can be found.
    ``roles``: that columns of a log play for it; ``triads``: of which it needs three axes.
    ``bench_clock``: its results are by the clock of the bench.
    """

    name: str
    module: str
    methods: tuple[str, ...]
    made_of: MadeOf
    conditions: tuple[str, ...] = ()
    fields: tuple[str, ...] = ()
    conditions_of_open: tuple[str, ...] | None = None
    words: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    rule: Rule | None = None
    reading: str = ""
    items: tuple[str, ...] = ()
    page: str = ""
    beside: str = ""
    limits: Mapping[str, Limit] = field(default_factory=dict)
    of_unit: tuple[str, ...] = ()
    of_channel: tuple[str, ...] = ()
    main: tuple[str, ...] = ()
    sizes: tuple[str, ...] = ()
    standards: Mapping[str, str] = field(default_factory=dict)
    problems: str = ""
    assumptions: str = ""
    roles: tuple[str, ...] = ()
    triads: tuple[str, ...] = ()
    predicted: str = ""
    predicts_long: bool = False
    point: str = ""
    design: str = ""
    bench_clock: bool = False


class ChannelKind(StrictModel):
    """Declared constants of one kind of channel."""

    channels: int | str | list[int | str] | None = Field(
        None, description="the unit's channels of this kind, such as 1-6; no other may be declared as one"
    )

    if TYPE_CHECKING:

        @property
        def full_scale(self) -> float:
            """Largest current, ampere."""

    def channel_constants(self, levels_A: list[float]) -> dict[str, Any]:
        """Return the constants of one channel for the manifest."""
        raise NotImplementedError


class Section(StrictModel):
    """A section of ``uut``; ``in_manifest``: what its fields are called there, in their order, units in the names."""

    in_manifest: ClassVar[tuple[str, ...]]

    def constants(self) -> dict[str, Any]:
        """Return them for the manifest, in base units; what is not stated is left out."""
        values = (getattr(self, field) for field in type(self).model_fields)
        return stated(dict(zip(self.in_manifest, values, strict=True)))


class UnitSections(StrictModel):
    """The sections of ``uut`` that belong to one system."""

    @classmethod
    def constants(cls, unit: Any) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign", in base units; what is not stated is left out.

        Args: unit: the sections of all systems.
        """
        sections = {name: getattr(unit, name) for name in cls.model_fields}
        return {name: section.constants() for name, section in sections.items() if section is not None}

    def channel_kind(self, name: str) -> ChannelKind | None:
        """Return what the data sheet says of a kind of channel, None if it says nothing."""
        return None


class LogColumn(StrictModel):
    """A column of numbers of an imported log.

    ``numbered``: it stands for many columns that differ by a number, ``{0..423}`` in its header.
    """

    numbered: ClassVar[bool] = False
    _number: int | None = PrivateAttr(None)

    if TYPE_CHECKING:

        @property
        def role(self) -> str:
            """The part that the column plays."""

        @property
        def quantity(self) -> str:
            """Its name in results and reports."""

        @property
        def unit(self) -> str:
            """Unit of the numbers in the file."""

    @property
    def factor(self) -> float:
        """Number that a number of the file is multiplied by."""
        return unit_of(self.unit)[0]

    @property
    def dimension(self) -> str:
        """Base unit of the values."""
        return unit_of(self.unit)[1]

    def of_number(self, number: int) -> LogColumn:
        """Return one of the many columns, whose quantity ends with its number."""
        column = self.model_copy()
        column._number = number
        return column

    def more(self) -> dict[str, str]:
        """Return what the manifest says of the column beside header, quantity, role and unit."""
        return {}


class Log(Protocol):
    """A mapping of a log, as far as the sections of a system look at it."""

    analysis: str

    @property
    def values(self) -> Mapping[str, LogColumn]:
        """Columns of numbers, by header."""

    @property
    def rate_Hz(self) -> float | None:
        """Rate of samples that are numbered."""


class LogSections(StrictModel):
    """The sections of a mapping that belong to one system; ``analyses`` are those whose needs it checks itself."""

    analyses: ClassVar[tuple[str, ...]] = ()

    def check_log(self, log: Log) -> None:
        """Check that the sections fit to the columns, and that the analysis has what it needs. Raises: ValueError."""

    def log_constants(self, log: Log) -> dict[str, Any]:
        """Return entries of the manifest's section "campaign"."""
        return {}

    def beyond(self, rows: int) -> tuple[tuple[str, ...], str, str] | None:
        """Return what lies outside of a log of so many rows: its place, what is wrong, what to do; else None."""
        return None


@dataclass(frozen=True)
class Hint:
    """How a column of a log may be told, for a mapping that is proposed.

    ``pattern``: in its name, small letters.   ``units``: each with the range of the median magnitude of the largest
    column in it; None if the role takes none.   ``by_axis``, ``numbered``: columns come by axis, or by number.
    ``more``: other keys.   ``analysis``: that may follow.
    """

    role: str
    pattern: str
    units: tuple[tuple[str, float, float], ...] | None = ()
    by_axis: bool = False
    more: Mapping[str, str] = field(default_factory=dict)
    analysis: str = ""
    numbered: bool = False


@dataclass(frozen=True)
class CoefficientsDeclaration:
    """A document of coefficients: ``of`` names what it compensates, ``module`` makes and merges it.

    ``header``: function that writes it as a C header.
    """

    of: str
    module: str
    header: str


@dataclass(frozen=True)
class Count:
    """What one count of a channel stands for, by the names of constants of the channel in the manifest.

    ``amount``: of one count.   ``full_scale``: largest amount in a second.   ``unit``: of amounts in a second.
    """

    amount: str
    full_scale: str
    unit: str


@dataclass(frozen=True)
class System:
    """A published system.

    ``limits``: those that any sequence may state, whatever its analysis is.   ``early``: module of early checks.
    ``count``: what the channels count, None if they count nothing.   ``studies``: modules by the name of the study.
    """

    name: str
    analyses: tuple[AnalysisDeclaration, ...]
    limits: Mapping[str, Limit] = field(default_factory=dict)
    unit: type[UnitSections] | None = None
    log: type[LogSections] | None = None
    log_columns: tuple[type[LogColumn], ...] = ()
    log_hints: tuple[Hint, ...] = ()
    coefficients: CoefficientsDeclaration | None = None
    early: str = ""
    count: Count | None = None
    studies: Mapping[str, str] = field(default_factory=dict)

    def analysis(self, name: str) -> AnalysisDeclaration:
        """Return the analysis of this name, which the system has."""
        return next(declared for declared in self.analyses if declared.name == name)


def unit_of(unit: str) -> tuple[float, str]:
    """Return factor and base unit of a unit that is known to be one."""
    known = read_quantity(f"1 {unit}")
    assert known is not None
    return known


def stated(constants: Mapping[str, _Stated | None]) -> dict[str, _Stated]:
    """Return the constants that are stated."""
    return {name: value for name, value in constants.items() if value is not None}
