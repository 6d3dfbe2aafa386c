"""Protocols by which the rooms of the bench know each other, and the declarations a driver makes about itself.

A driver declares its actions with ``@action``; the static check and the sequencer read the declarations, so neither
needs to know a model of instrument. ``Tells`` says which of its replies mean that something is on, and how far: the
state of the bench that people see is made of replies alone, so that a recording gives it too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cache, cached_property
from typing import Any, NamedTuple, Protocol, TypeVar, assert_never


@dataclass(frozen=True)
class Figure:
    """What a reply gives to read: ``name`` for people ("current"), its base unit, and how it is read.

    ``read`` raises ValueError for a reply of another form. Closed crosspoints have no unit: it returns their names.
    """

    name: str
    unit: str
    read: Callable[[str], float | tuple[str, ...]]


@dataclass(frozen=True)
class Tells:
    """What the replies of one model tell, by question as the driver sends it.

    ``on``: questions of which each says whether something is on, closed or turning (True); it is off when all say so.
    ``figures``: questions that say how far.
    """

    on: Mapping[str, Callable[[str], bool]]
    figures: Mapping[str, Figure] = field(default_factory=dict)


def is_one(reply: str) -> bool:
    """Return whether a switch reads back on. Raises: ValueError unless it is 0 or 1."""
    value = float(reply)
    if value not in (0.0, 1.0):
        raise ValueError("0 or 1 is due")
    return value == 1.0


class Effect(Enum):
    """Effects of an action on the bench, as far as safety and order are concerned."""

    NONE = "none"  # reads, or sets something without consequence for safety
    STIMULUS_SET = "stimulus_set"  # programs a level; does not switch the output
    STIMULUS_ON = "stimulus_on"  # output on
    STIMULUS_OFF = "stimulus_off"  # output off: always allowed
    ROUTE = "route"  # closes one route (and opens every other one)
    ROUTES_OPEN = "routes_open"  # opens every route
    THERMAL = "thermal"  # changes the temperature of the unit under test
    POWER = "power"  # changes the supply of the unit under test
    MOTION_ON = "motion_on"  # from here on a table may move; nobody may stand at it
    MOTION_OFF = "motion_off"  # the table is at rest and its drives are off: always allowed

    @property
    def energises(self) -> bool:
        """Return whether it switches something on or lets it move."""
        match self:
            case Effect.STIMULUS_ON | Effect.ROUTE | Effect.THERMAL | Effect.POWER | Effect.MOTION_ON:
                return True
            case Effect.NONE | Effect.STIMULUS_SET | Effect.STIMULUS_OFF | Effect.ROUTES_OPEN | Effect.MOTION_OFF:
                return False
            case _:
                assert_never(self)


ENERGISING = frozenset(effect for effect in Effect if effect.energises)
"""Effects of actions that switch something on or let it move."""
DE_ENERGISING = frozenset({Effect.STIMULUS_OFF, Effect.ROUTES_OPEN, Effect.MOTION_OFF})
"""Effects of actions behind which the whole instrument is off."""

SWITCHED_ON = ("output_on", "operate", "run", "start")
SWITCHED_OFF = ("output_off", "standby", "stop", "open_all")
SWITCHES = (*SWITCHED_ON, *SWITCHED_OFF, "route")
"""Actions of one instrument of which the later counts."""


@dataclass(frozen=True)
class Parameter:
    """One argument of an action: a quantity with a dimension and limits, or a choice of words or numbers.

    ``dimension`` is a base unit of bench.model.units ("A", "degC" ...), or "" for a choice/plain value; ``values``
    are the only ones of a quantity that the instrument can be set to, in order, if there are no others between.
    """

    name: str
    dimension: str = ""
    low: float | None = None
    high: float | None = None
    choices: tuple[str | int, ...] = ()
    required: bool = True
    values: tuple[float, ...] = ()


@dataclass(frozen=True)
class Action:
    """Declaration of one driver method that a sequence may call as ``role.name``."""

    name: str
    parameters: tuple[Parameter, ...] = ()
    effect: Effect = Effect.NONE
    bus_s: float = 0.1  # longest time the call normally takes on the real bus, settling included
    returns: str = ""  # unit of the value returned, "" if none
    longer: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @cached_property
    def sets(self) -> bool:
        """Return whether the action changes its instrument, as far as its declaration can tell."""
        plain = not self.returns and (bool(self.parameters) or self.name in SWITCHES)
        return self.effect is not Effect.NONE or plain

    def takes_s(self, arguments: Mapping[str, Any]) -> float:
        """Return the longest time that a call with these arguments normally takes on the real bus, second.

        ``longer``: above which magnitude of an argument it takes longer than ``bus_s``, and how long.
        """
        times_s = [self.bus_s]
        for name, (magnitude, time_s) in self.longer.items():
            value = arguments.get(name)
            if isinstance(value, int | float) and abs(value) > magnitude:
                times_s.append(time_s)
        return max(times_s)


_F = TypeVar("_F", bound=Callable[..., Any])
_DECLARATION = "_bench_action"


def action(
    *parameters: Parameter,
    effect: Effect = Effect.NONE,
    bus_s: float = 0.1,
    returns: str = "",
    longer: Mapping[str, tuple[float, float]] | None = None,
) -> Callable[[_F], _F]:
    """Declare a driver method as an action of the sequence language; its name is the method's name."""

    def mark(method: _F) -> _F:
        setattr(method, _DECLARATION, Action(method.__name__, parameters, effect, bus_s, returns, longer or {}))
        return method

    return mark


Actions = Mapping[str, Action]
"""Declared actions of an instrument, by name."""
Drivers = Mapping[str, Actions]
"""The same by role."""


@cache
def actions_of(driver: type) -> Actions:
    """Return all actions a driver class declares, by name."""
    actions: dict[str, Action] = {}
    for name in dir(driver):
        declaration = getattr(getattr(driver, name, None), _DECLARATION, None)
        if isinstance(declaration, Action):
            actions[name] = declaration
    return actions


def drivers_of(instruments: Mapping[str, Instrument]) -> Drivers:
    """Return all actions that the drivers of some instruments declare."""
    return {role: actions_of(type(instrument)) for role, instrument in instruments.items()}


def can_move(actions: Actions) -> bool:
    """Return whether an instrument with these actions is a table."""
    return any(action.effect is Effect.MOTION_ON for action in actions.values())


def effects_of(driver: type) -> frozenset[Effect]:
    """Return all effects that the actions of a driver class declare."""
    return frozenset(action.effect for action in actions_of(driver).values())


@dataclass(frozen=True)
class Identity:
    """The identity that an instrument states."""

    manufacturer: str
    model: str
    serial: str
    firmware: str


class Transcript(Protocol):
    """The transcript that every command and reply of an instrument goes to."""

    def __call__(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        """``direction`` is "tx" or "rx"."""


class StateRow(NamedTuple):
    """A setting that a run relies on, as it is now.

    ``command``: sets it right, "" where only a person can, as ``advice`` says.   ``reply``: to its question.
    ``right``: None where nothing can be asked.
    """

    name: str
    command: str
    reply: str
    right: bool | None
    advice: str


class Instrument(Protocol):
    """A driver as the sequencer needs it, beside its declared actions."""

    role: str

    def identify(self) -> Identity:
        """Ask who is there and refuse another model (InstrumentError B-INST-002)."""

    def introduce(self) -> Identity:
        """Ask who is there and refuse another model; nothing is prepared."""

    def state_rows(self) -> Iterator[StateRow]:
        """Ask what the last user left, row by row of the state table; nothing is set."""

    def make_safe(self) -> None:
        """Bring the instrument to its declared safe state; idempotent, may be called in any state."""

    def drain_errors(self) -> list[str]:
        """Read the error queue until it is empty; oldest first."""

    def close(self) -> None:
        """Release the bus session."""


class ByteLink(Protocol):
    """A serial link to the unit under test (pySerial's interface, as far as the bench uses it)."""

    def read(self, size: int = 1) -> bytes:
        """Return up to ``size`` bytes that are there; never waits."""

    def write(self, data: bytes) -> int | None:
        """Send bytes."""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""

    def close(self) -> None:
        """Close the port."""


class SessionSink(Protocol):
    """A session as the run writes into it (bench.record.SessionWriter)."""

    def raw(self, link: str, direction: str, t_mono_ns: int, chunk: bytes) -> None:
        """Raw bytes of a link; direction "rx" or "tx"."""

    def command(self, role: str, direction: str, text: str, t_mono_ns: int) -> None:
        """One command to ("tx") or reply of ("rx") an instrument."""

    def event(self, kind: str, t_mono_ns: int, fields: Mapping[str, Any]) -> None:
        """Anything that happened: step, record, prompt, slip, alarm ..."""


@dataclass(frozen=True)
class RecordWindow:
    """One record: ``frames`` frames of a link from an unwrapped counter on, with the conditions it was taken under.

    A record that is made of readings of instruments belongs to no link ("") and has no frames. ``uut``: the unit under
    test it belongs to, None where a bench has only one.

    ``conditions`` holds the loop variables and set-points by field name with unit suffix, for example
    {"channel": 1, "kind": "gyro", "temperature_degC": -10.0, "current_A": 3e-5, "polarity": 1, "range_A": 2.2e-4,
     "route": "closed"}; ``polarity`` is +1 or -1, ``route`` is "open" or "closed".
    """

    number: int
    link: str
    first_counter: int
    frames: int
    t_start_ns: int
    t_end_ns: int
    conditions: Mapping[str, Any] = field(default_factory=dict)
    step: int = -1
    uut: str | None = None
