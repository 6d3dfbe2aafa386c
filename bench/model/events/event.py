"""The base of every event of a session: a kind, typed fields, a sentence for a person, and how bad it is.

In a session an event is JSON: its kind and its fields (docs/session-format.md). A class may gain fields; it never loses
one, because older sessions are read for ever. A field that an event does not have is left out where its declaration
says so (``left_out``), else it is written.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from types import NoneType, UnionType
from typing import (
    Any,
    ClassVar,
    Literal,
    Self,
    TypeVar,
    Union,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

Severity = Literal["none", "warning", "alarm", "fault"]
_LEFT_OUT, _RAW = "left_out", "raw"


def left_out(default: Any = None) -> Any:
    """Declare a field that is not written while it has its default."""
    return field(default=default, metadata={_LEFT_OUT: True})


@dataclass(frozen=True, kw_only=True)
class Event:
    """One event. ``uut``: the unit under test it belongs to, None where a bench has only one.

    ``raw`` is what a session says of an event that is not as its class declares it: of a kind that is not known, or
    with fields that are missing or of another type. Such an event has values that mean "unknown" (``nan``, -1, "").
    """

    kind: ClassVar[str] = ""
    at_terminal: ClassVar[bool] = False
    recorded: ClassVar[bool] = True  # it stands in the session
    severities: ClassVar[Mapping[str, Severity]] = {}  # by ``state``, "" for any other one

    uut: str | None = left_out()
    raw: Mapping[str, Any] | None = field(default=None, repr=False, compare=False, metadata={_RAW: True})

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the fields that a session lacks or has with another type."""
        return () if self.raw is None else tuple(name for name, _, fits in _stored(type(self), self.raw) if not fits)

    @property
    def sentence(self) -> str:
        """One line for the page, the terminal and the report; "" for what nobody needs to read."""
        if self.raw is not None and self._is_worded:
            return ", ".join(f"{name} {_short(value)}" for name, value in self.raw.items()) or self.kind
        return " ".join(self._words().split())

    @property
    def told(self) -> bool:
        """Whether a person at the terminal reads it when it happens."""
        return self.at_terminal

    @property
    def severity(self) -> Severity:
        """How bad it is."""
        return self.severities.get(getattr(self, "state", ""), self.severities.get("", "none"))

    @property
    def topic(self) -> str:
        """Text that is the same for the same trouble at another time."""
        return self.kind

    @property
    def lasts(self) -> bool:
        """Whether the trouble lasts until another event says that it is over."""
        return False

    @property
    def error_code(self) -> str | None:
        """Stable code of the error it tells of, None if it tells of none."""
        return None

    def document(self) -> dict[str, Any]:
        """Return the fields as they stand in a session."""
        document = {}
        for declared in fields(self):
            value = getattr(self, declared.name)
            is_left_out = _RAW in declared.metadata or (_LEFT_OUT in declared.metadata and value == declared.default)
            if not is_left_out:
                document[declared.name] = value
        return document

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> Self:
        """Make the event of fields that a session holds; it never fails."""
        known: dict[str, Any] = {}
        strange = False
        for name, value, fits in _stored(cls, document):
            known[name] = value
            strange = strange or not fits
        return cls(**known, raw=document if strange else None)

    def _words(self) -> str:
        return ""

    @property
    def _is_worded(self) -> bool:
        return type(self)._words is not Event._words


Model = TypeVar("Model", bound=Event)
_CLASSES: dict[tuple[str, str], type[Event]] = {}  # by kind, and by ``what`` where a kind has a class for each


@dataclass_transform(kw_only_default=True, frozen_default=True)
def event(
    kind: str, *, at_terminal: bool = False, severity: Severity | Mapping[str, Severity] | None = None
) -> Callable[[type[Model]], type[Model]]:
    """Make a class one of the events that a session may hold.

    ``at_terminal``: a person there reads it.   ``severity``: of all of them, or by ``state``; None: as the base has it.
    """

    def register(model: type[Model]) -> type[Model]:
        model.kind, model.at_terminal = kind, at_terminal
        if severity is not None:
            model.severities = {"": severity} if isinstance(severity, str) else severity
        _CLASSES[kind, vars(model).get("what", "")] = model
        return dataclass(frozen=True, kw_only=True)(model)

    return register


def kinds_of_events() -> frozenset[str]:
    """Return every kind of event that a session may hold."""
    return frozenset(kind for kind, _ in _CLASSES)


def event_of(kind: str, document: Mapping[str, Any]) -> Event:
    """Return the event that a session holds. An event of a kind that is not known is an ``Event`` with its fields."""
    model = _CLASSES.get((kind, str(document.get("what")))) or _CLASSES.get((kind, ""))
    return Event(raw=document) if model is None else model.read(document)


def number(value: float, form: str = "g") -> str:
    """Return a number for a sentence; "none" for one that is not known."""
    return "none" if math.isnan(value) else format(value, form)


_UNKNOWN: Mapping[Any, Any] = {
    float: math.nan, int: -1, str: "", bool: False, Sequence: (), Mapping: {}, Literal: "",
}  # fmt: skip
_JSON: Mapping[Any, Any] = {float: (int, float), Sequence: (list, tuple)}


class _Nothing:
    """Stands for a field that is missing."""


_Accept = Callable[[Any], tuple[Any, bool]]


_Declared = tuple[tuple[Field[Any], _Accept], ...]
_KNOWN: dict[type[Event], _Declared] = {}


def _declared(model: type[Event]) -> _Declared:
    if model not in _KNOWN:
        hints = get_type_hints(model)
        stored = (declared for declared in fields(model) if _RAW not in declared.metadata)
        _KNOWN[model] = tuple((declared, _accept(hints[declared.name])) for declared in stored)
    return _KNOWN[model]


def _stored(model: type[Event], document: Mapping[str, Any]) -> Iterator[tuple[str, Any, bool]]:
    """Yield name, value and whether it is as declared, of the fields that a session has or should have."""
    for declared, accept in _declared(model):
        if declared.name in document:
            yield declared.name, *accept(document[declared.name])
        elif declared.default is MISSING and declared.default_factory is MISSING:
            yield declared.name, *accept(_Nothing)


def _accept(hint: Any) -> _Accept:
    """Return what takes a JSON value for a declared type: (value, whether it is as declared)."""
    kinds = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    unknown = None if NoneType in kinds or Any in kinds else _UNKNOWN[get_origin(hint) or hint]
    whole = int in kinds and float not in kinds

    def accept(value: Any) -> tuple[Any, bool]:
        if value is None and hint is float:
            return math.nan, True  # JSON has no other word for a number that is none
        if whole and isinstance(value, float) and value.is_integer():
            return int(value), True  # nor two sorts of numbers
        fits = value is not _Nothing and any(_fits(value, kind) for kind in kinds)
        return (value if fits else unknown), fits

    return accept


def _fits(value: Any, kind: Any) -> bool:
    if kind is Any:
        return True
    origin = get_origin(kind) or kind
    if origin is Literal:
        return value in get_args(kind)
    if isinstance(value, bool) and origin is not bool:
        return False
    return isinstance(value, _JSON.get(origin, origin))


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
