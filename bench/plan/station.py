"""Station files: which instrument sits at which address of which bench, and the register of its standards."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, StringConstraints, field_validator, model_validator

from bench.model.drivers import driver_class
from bench.model.errors import InputError, InputErrors
from bench.model.ports import Action, Drivers, actions_of
from bench.model.units import likely, quantity, read_quantity
from bench.model.yamlio import Document, Name, StrictModel, load_yaml
from bench.plan.findings import Findings, suggestion
from bench.plan.language.graphs import MOST_GRAPHS, GraphEntry
from bench.plan.language.interlocks import Interlock
from bench.plan.language.notices import Notify
from bench.plan.language.standards import Standard, Words, told_standard
from bench.plan.values import Scalar

OptionName = Annotated[str, StringConstraints(pattern=r"^[a-z][A-Za-z0-9_]{0,39}$")]  # its unit may be a capital
NUMBERS = (
    "_ppm", "_A", "_V", "_s", "_Hz", "_degC", "_arcmin", "_deg", "_deg_h", "time_constants",
)  # how options that are numbers end  # fmt: skip
# Options that are neither numbers nor on or off; the world judges them.
TEXTS = ("faults", "parameters", "unit_seed", "check_standard")
SlotName = Annotated[str, StringConstraints(pattern=r"^[A-H]$")]
CHAMBER_MARGIN_DEGC, UNIT_MARGIN_DEGC = 5.0, 10.0  # hard limits above the highest set-point; the unit warms itself


_ADAPTER = re.compile(r"PRLGX-(?:TCPIP(\d*)::([^:]+)(?:::(\d+))?|ASRL(\d*)::(/?[^:]+))::INTFC", re.IGNORECASE)


def _adapter(text: str) -> str:
    if _ADAPTER.fullmatch(text) is None:
        raise ValueError(
            f"{text!r} is no GPIB adapter; write it as PRLGX-TCPIP0::10.0.0.7::1234::INTFC or as "
            "PRLGX-ASRL0::/dev/serial/by-id/NAME::INTFC: it is GPIB0 then, its instruments GPIB0::22::INSTR"
        )
    return text


class SerialLine(StrictModel):
    """Settings of the serial line of an instrument."""

    baud: int = Field(9600, ge=110, le=1_000_000)
    bits: Literal[7, 8] = 8
    parity: Literal["none", "odd", "even", "mark", "space"] = "none"
    stop: Literal[1, 2] = 1
    handshake: Literal["none", "xon_xoff", "rts_cts", "dtr_dsr"] = "none"


class InstrumentEntry(StrictModel):
    """One instrument of the bench under its role."""

    driver: Name
    resource: Words
    safe_order: int = Field(ge=1, le=99, description="place in the order in which instruments are made safe")
    options: dict[Name, Scalar | list[Scalar]] = Field(default_factory=dict)
    limits: dict[Name, tuple[str, str]] = Field(default_factory=dict, description="argument: [lowest, highest]")
    serial_line: SerialLine | None = Field(None, description="of an instrument at ASRL...::INSTR")
    standard: Standard | None = None

    @property
    def line(self) -> Mapping[str, Any]:
        """Settings of its serial line, empty if none are named."""
        return {} if self.serial_line is None else self.serial_line.model_dump()

    @model_validator(mode="after")
    def _line_of_a_serial_port(self) -> InstrumentEntry:
        if self.serial_line is not None and not self.resource.upper().startswith("ASRL"):
            raise ValueError(f"{self.resource} has no 'serial_line': it is no serial port (ASRL...::INSTR)")
        return self

    @field_validator("limits", mode="before")
    @classmethod
    def _with_units(cls, limits: object) -> object:
        for name, pair in limits.items() if isinstance(limits, dict) else ():
            for bare in (limit for limit in pair if isinstance(limit, int | float)) if isinstance(pair, list) else ():
                raise ValueError(f"{name}: {bare} has no unit; write [lowest, highest] with units: ['0 V', '20 V']")
        return limits

    @field_validator("limits")
    @classmethod
    def _quantities(cls, limits: dict[str, tuple[str, str]]) -> dict[str, tuple[str, str]]:
        for name, (low, high) in limits.items():
            pair = read_quantity(low), read_quantity(high)
            if pair[0] is None or pair[1] is None or pair[0][1] != pair[1][1] or pair[0][0] > pair[1][0]:
                meant = likely(low) or likely(high)
                raise ValueError(f"{name}: [{low}, {high}] is not a range of one quantity, lowest first{meant}")
        return limits


class LinkEntry(StrictModel):
    """A serial link to the unit under test; a simulated bench gives the URL itself.

    With ``instrument`` the bytes are those that an instrument of the bench has buffered, and there is no port.
    """

    frame: Name
    baud: int | None = Field(None, ge=300, le=10_000_000)
    url: Words | None = None
    instrument: Name | None = Field(None, description="role of the instrument that sends what is recorded")
    poll: Annotated[float, *quantity("s", 1e-4, 1.0)] = Field(
        1.0, description="virtual clock: how often the link is read, so how well receive stamps are known"
    )

    @model_validator(mode="after")
    def _one_source(self) -> LinkEntry:
        if self.instrument is None and self.baud is None:
            raise ValueError("a link has a 'baud', or the 'instrument' whose buffer is read")
        if self.instrument is not None and (self.baud is not None or self.url is not None):
            raise ValueError("a link that is read from an instrument has no 'baud' and no 'url'")
        return self


class Slot(StrictModel):
    """A place in the chamber for a unit under test, with what belongs to it alone."""

    links: dict[Name, Name] = Field(min_length=1, description="what a sequence calls a link: the link of this slot")
    roles: dict[Name, Name] = Field(
        min_length=1, description="what a sequence calls an instrument, such as supply: the instrument of this slot"
    )
    card: int | None = Field(None, ge=1, le=10, description="of the switch matrix, that leads to the unit")
    gradient: Annotated[float, *quantity("degC", 0.0, 20.0)] | None = Field(
        None, description="95 %: how far the unit may be from its own sensor, by gradients and the heat of neighbours"
    )


class World(StrictModel):
    """The simulated wiring and physics. An option set to null is known and left to the world."""

    name: Name
    options: dict[OptionName, Scalar | None] = Field(default_factory=dict)


class GuardLimits(StrictModel):
    """Temperatures at which the guard switches the heat off; None: derived from the chamber's declared limit."""

    chamber_air: Annotated[float, *quantity("degC", -50.0, 250.0)] | None = None
    unit: Annotated[float, *quantity("degC", -50.0, 250.0)] | None = None


class Guard(StrictModel):
    """Limits beyond which the guard acts (docs/unattended.md)."""

    limits: GuardLimits = GuardLimits()
    silence: Annotated[float, *quantity("s", 1.0, 3.0)] = 2.0  # how long the controller may be silent


class ArmAfterHold(StrictModel):
    """Nobody is asked to arm the bench after a hold, for a reason that is recorded and shown."""

    never: Words = Field(description="reason, for example that nobody can reach the bench while it runs")


class StationFile(StrictModel):
    """A file in stations/.

    A real station and a *served* one (simulated, by another process in real time) have no world and say where their
    links are; any other simulated station has a world, which this process opens.
    """

    station: Name
    title: Annotated[str, StringConstraints(max_length=200)] = ""
    simulated: bool
    visa: Literal["@bench", "@py", "@ivi", "@sim"]
    adapters: list[Annotated[str, AfterValidator(_adapter)]] = Field(
        default_factory=list, description="Prologix adapters; the number in the address is that of the GPIB board"
    )
    world: World | None = None
    control: Words | None = Field(
        None, description="socket of the process that serves a simulated bench; it is told there what a prompt sets"
    )
    bus_time_factor: float = Field(
        1.0,
        ge=0.01,
        le=1.0,
        description="of the declared bus times, on a simulated bench that is faster than a real one",
    )
    instruments: dict[Name, InstrumentEntry] = Field(min_length=1)
    standards: dict[Name, Standard] = Field(
        default_factory=dict, description="standards without an interface, such as a reference probe"
    )
    links: dict[Name, LinkEntry]
    slots: dict[SlotName, Slot] = Field({}, description="places for several units under test, A to H")
    interlocks: dict[Name, Interlock] = Field(default_factory=dict)
    guard: Guard = Guard()
    arm_after_hold: ArmAfterHold | None = None
    notify: Notify | None = None
    graphs: list[GraphEntry] = Field(
        default_factory=list, max_length=MOST_GRAPHS, description="graph windows of the live page"
    )

    @model_validator(mode="after")
    def _consistent(self) -> StationFile:
        if self.world is not None and not self.simulated:
            raise ValueError("a real station has no 'world'")
        if self.simulated and self.world is None and self.visa == "@bench":
            raise ValueError("a simulated station has a 'world', or is served by another process and reached by '@py'")
        if self.control is not None and (self.world is not None or not self.simulated):
            raise ValueError("'control' is for a simulated station that is served by another process")
        missing = [
            name
            for name, link in self.links.items()
            if self.world is None and link.url is None and link.instrument is None
        ]
        if missing:
            raise ValueError(f"the url of link {missing[0]!r} is missing")
        if len(boards_of(self.adapters)) < len(self.adapters):
            raise ValueError("two adapters have one number of a GPIB board; write PRLGX-TCPIP0::..., PRLGX-TCPIP1::...")
        if doubled := sorted(self.standards.keys() & self.instruments.keys()):
            raise ValueError(f"{doubled[0]!r} is an instrument; its standard stands there")
        strange = [link.instrument for link in self.links.values() if link.instrument not in (None, *self.instruments)]
        if strange:
            raise ValueError(f"a link is read from {strange[0]!r}, which is no instrument of the station")
        hard, highest_degC = self.guard.limits.chamber_air, _highest_degC(self.instruments)
        if hard is not None and highest_degC is not None and hard <= highest_degC:
            raise ValueError(
                f"guard: the hard limit chamber_air of {hard:g} degC is not above the chamber's own limit of "
                f"{highest_degC:g} degC; raise it, or lower 'limits: {{temperature: [...]}}' of the chamber"
            )
        _check_slots(self)
        if self.bus_time_factor != 1.0 and not self.simulated:
            raise ValueError("'bus_time_factor' is for simulated stations: a real bus takes its time")
        return self


def _check_slots(station: StationFile) -> None:
    """Refuse a slot with links or instruments that the station does not have, or that another slot has, too."""
    taken: dict[str, str] = {}
    for letter, slot in station.slots.items():
        for own in (*slot.links.values(), *slot.roles.values()):
            if own not in (*station.links, *station.instruments):
                raise ValueError(f"slot {letter}: the station has no link or instrument {own!r}")
            if taken.setdefault(own, letter) != letter:
                raise ValueError(f"slots {taken[own]} and {letter} both have {own!r}")


@dataclass(frozen=True)
class Station:
    """A checked station. ``world_options`` are texts; an option of the world that is left alone is absent.

    ``path`` is the file it was read from: what is known of this bench alone lies beside it.
    """

    document: Document[StationFile] = field(repr=False)
    world_options: Mapping[str, str]
    path: Path = field(default_factory=Path, compare=False)

    @cached_property
    def file(self) -> StationFile:
        """The station file as a model."""
        return self.document.model

    @property
    def name(self) -> str:
        """Name of the station."""
        return self.file.station

    @property
    def simulated(self) -> bool:
        """True when nothing of it is real."""
        return self.file.simulated

    @property
    def never_armed(self) -> str:
        """Reason why nobody is asked to arm the bench after a hold, "" if somebody is."""
        declared = self.file.arm_after_hold
        return "" if declared is None else declared.never

    @property
    def in_process(self) -> bool:
        """True when this process opens its simulated world; only then the virtual clock may drive it."""
        return self.file.world is not None

    @cached_property
    def instruments(self) -> Mapping[str, InstrumentEntry]:
        """Instruments by role."""
        return self.file.instruments

    @property
    def guard_limits_degC(self) -> dict[str, float]:
        """Hard limits by name of the quantity, degC; without a chamber only those that are written down."""
        written, highest_degC = self.file.guard.limits, _highest_degC(self.instruments)
        limits = {}
        for name, limit, margin_degC in (
            ("chamber_air_degC", written.chamber_air, CHAMBER_MARGIN_DEGC),
            ("unit_degC", written.unit, UNIT_MARGIN_DEGC),
        ):
            if limit is not None:
                limits[name] = limit
            elif highest_degC is not None:
                limits[name] = highest_degC + margin_degC
        return limits

    @cached_property
    def boards(self) -> Mapping[str, str]:
        """GPIB boards that are adapters, and the VISA addresses of the streams to them."""
        return boards_of(self.file.adapters)

    @property
    def links(self) -> Mapping[str, LinkEntry]:
        """Links by name."""
        return self.file.links

    @property
    def safe_order(self) -> tuple[str, ...]:
        """Roles in the order in which they are made safe."""
        return tuple(sorted(self.instruments, key=lambda role: (self.instruments[role].safe_order, role)))

    def wiring(self) -> dict[str, Any]:
        """Return instruments and links as plain values, for whoever opens the bench or its simulation."""
        return {
            "instruments": {
                role: {
                    "driver": entry.driver,
                    "resource": entry.resource,
                    "options": dict(entry.options),
                    "serial": "" if entry.standard is None else entry.standard.serial,
                }
                for role, entry in self.instruments.items()
            },
            "links": {name: link.model_dump(mode="json") for name, link in self.links.items()},
            "slots": {letter: slot.model_dump(mode="json") for letter, slot in sorted(self.file.slots.items())},
        }

    def standards(self) -> dict[str, dict[str, Any]]:
        """Return the standards register for the session's manifest, by role, in SI base units."""
        of_instruments = {
            role: told_standard(entry.driver, entry.standard)
            for role, entry in self.instruments.items()
            if entry.standard is not None
        }
        return of_instruments | {name: told_standard("", standard) for name, standard in self.file.standards.items()}

    def ranges_A(self, role: str) -> tuple[float, ...]:
        """Return ranges a role's standard has an uncertainty for, ampere, lowest first."""
        entry = self.instruments.get(role)
        standard = None if entry is None else entry.standard
        return () if standard is None else tuple(sorted(line.range for line in standard.uncertainty))

    def with_options(self, overrides: Mapping[str, str]) -> Station:
        """Change options of the simulated world.

        Raises: InputErrors with B-PLAN-004 for an option it does not have, B-PLAN-015 for an impossible value.
        """
        known = self.file.world.options if self.file.world is not None else {}
        findings = Findings()
        for name, text in overrides.items():
            if mistake := option_mistake(name, text, known):
                findings.add(mistake[0], f"--set world.{name}", mistake[1])
        if findings:
            raise InputErrors(findings.sorted())
        return replace(self, world_options={**self.world_options, **overrides})


def _highest_degC(instruments: Mapping[str, InstrumentEntry]) -> float | None:
    """Return highest set-point any instrument of the station may be given, degC; None if none is declared."""
    highest = [
        read_quantity(entry.limits["temperature"][1]) for entry in instruments.values() if "temperature" in entry.limits
    ]
    return max((value[0] for value in highest if value is not None), default=None)


def boards_of(adapters: Sequence[str]) -> dict[str, str]:
    """Return the GPIB boards that adapters are, and the VISA addresses of the streams to them."""
    boards = {}
    for match in filter(None, map(_ADAPTER.fullmatch, adapters)):
        lan, host, port, usb, device = match.groups()
        stream = f"TCPIP0::{host}::{port or 1234}::SOCKET" if host else f"ASRL{device}::INSTR"
        boards[f"GPIB{lan or usb or 0}"] = stream
    return boards


def load_station(path: Path) -> Station:
    """Read and check a station file. Raises InputErrors."""
    document = load_yaml(path, StationFile)
    world = document.model.world
    options = {} if world is None else {k: option_text(v) for k, v in world.options.items() if v is not None}
    return Station(document, options, path)


def option_mistake(name: str, value: Scalar | None, known: Collection[str]) -> tuple[str, str] | None:
    """Return code and message of what is wrong with an option of a world that knows some: B-PLAN-004, -015; or None."""
    if name not in known:
        return "B-PLAN-004", f"the world has no option {name!r}{suggestion(name, known)}"
    due = "" if value is None else _wrong_option(name, option_text(value))
    return ("B-PLAN-015", f"world option {name} is {value!r}; {due}") if due else None


def _wrong_option(name: str, text: str) -> str:
    """Return what is due if an option of a simulated world cannot have this value, else "".

    As everywhere a name with the suffix of a unit is a number; every other option is on or off.
    """
    if name in TEXTS:
        return ""
    if not name.endswith(NUMBERS):
        return "" if text in ("on", "off") else "'on' or 'off' is due"
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    return "" if math.isfinite(number) else "a number is due"


def option_text(value: Scalar) -> str:
    """Return an option of a world as the text the world is given."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def declared_at(station: Station, *path: str) -> str:
    """Return name of a station's file and line of an entry, as ``af_bench_sim.yaml:24``."""
    where = station.document.where(path)
    return f"{PurePath(station.document.name).name}:{where.split(':')[-2]}"


def no_instrument(station: Station, role: str) -> str:
    """Return the sentence about a role that is called and not declared."""
    known = suggestion(role, station.instruments)
    return f"station {station.name} has no instrument {role!r} ({declared_at(station, 'instruments')}){known}"


def driver_actions(name: str) -> Mapping[str, Action]:
    """Return declared actions of a driver, by name."""
    return actions_of(driver_class(name))


def driver_ladder_A(name: str) -> tuple[float, ...]:
    """Return current ranges of a source as its driver declares them (``ranges_A``), ampere, lowest first; else ().

    Raises: InputError B-PLAN-010, B-PLAN-011.
    """
    return tuple(sorted(getattr(driver_class(name), "ranges_A", ())))


def range_after(ladder_A: Sequence[float], level_A: float, locked: bool, before_A: float | None) -> float | None:
    """Return range of a source after a level was set: the lowest that holds it, or the range before if that is locked.

    None if no range holds the level, or if the locked range is not known.
    """
    if locked:
        return before_A if before_A is not None and abs(level_A) <= before_A else None
    return next((limit_A for limit_A in sorted(ladder_A) if abs(level_A) <= limit_A), None)


def declared_action(station: Station, role: str, name: str) -> Action | None:
    """Return declaration of ``role.name``, or None if the station or the driver has no such thing."""
    entry = station.instruments.get(role)
    try:
        return None if entry is None else _declared(entry.driver, name)
    except InputError:
        return None


def station_drivers(station: Station) -> Drivers:
    """Return the declared actions of each role; none of a driver that cannot be had."""
    drivers: dict[str, Mapping[str, Action]] = {}
    for role, entry in station.instruments.items():
        with suppress(InputError):
            drivers[role] = driver_actions(entry.driver)
    return drivers


@lru_cache(maxsize=1024)
def _declared(driver: str, name: str) -> Action | None:
    return driver_actions(driver).get(name)
