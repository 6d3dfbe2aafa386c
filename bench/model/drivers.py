"""Finds the driver class a station names, by plain name, so that a YAML cannot run code of its choosing; and what the
manual of its model says of each command that it sends: one YAML file beside the driver.

The pages in docs/instruments are written from these files (docs/site/manuals.py), ``bench commission`` walks through
them at a real instrument, and what a driver sends in the tests must stand in its file.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from bench.model import lab
from bench.model.errors import InputError
from bench.model.installed import (
    driver_refusals,
    load,
    package_of_driver,
    refuse_unknown,
    unusable,
    whose,
)
from bench.model.yamlio import StrictModel, parse_yaml

Touch = Literal["asks", "sets", "energises", "moves"]
State = Literal["confirmed", "derived", "unconfirmed"]
TOUCHES: tuple[Touch, ...] = ("asks", "sets", "energises", "moves")  # in the order of a first contact
_NUMBER = r"[-+]?\d*\.?\d+(?:[eE][-+]?\d+)?"
_CONTROLS = "".join(map(chr, range(33)))
_ARGUMENT = re.compile(r"\{[^}]*\}")


class Command(StrictModel):
    """What is known of one command."""

    source: str = Field(description="key of a source, and where in it")
    state: State = Field("confirmed", description="read there; concluded from it; or assumed")
    reply: str = Field("", description="regular expression of the whole reply; NUMBER stands for one in figures")
    touch: Touch = Field("asks", description="what sending it does to the bench")
    of: dict[str, str] = Field({}, description="options of the station whose model has it, such as a dialect")
    example: str = Field("", alias="try", description="as it may be sent at a first contact; empty: never alone")
    after: str = Field("", description="command sent before it, where it is refused otherwise")
    shown: dict[str, str] = Field(
        {}, description="questions that show what it did, and their replies: the first that the station's model has"
    )


def replies_so(form: str, reply: str) -> bool:
    """Return whether a reply has the documented form; frames and terminators aside."""
    return re.fullmatch(form.replace("NUMBER", _NUMBER), reply.strip(_CONTROLS)) is not None


class Condition(StrictModel):
    """A row of the state table: a setting or a condition that changes a number or a hazard, and how a run has it right.

    It is set unless its question shows it right; one without ``set`` is refused unless it is right; one without ``ask``
    is set unseen. A word of the station stands in braces: ``(@{channels})``.
    """

    source: str = Field(description="key of a source, and where in it")
    when: list[str] = Field(["prepare"], description="actions that begin with it; prepare: identification does")
    of: dict[str, str] = Field({}, description="options of the station for which it holds, such as a dialect")
    set: str = Field("", description="command that makes it right")
    ask: str = Field("", description="question that shows it")
    right: str = Field("", description="regular expression of the reply that is right, in capitals, without blanks")
    bits: int = Field(0, description="bits of a reply in figures that are 0 where it is right")
    by: list[str] = Field([], description="commands of the actions that make it right, too")
    why: str = Field("", description="what is wrong otherwise; of one that is neither set nor asked: why not")
    person: str = Field("", description="what a person does where it is refused")
    left: list[str] = Field([], description="as a last user may leave it: commands, or 'key' and what is pressed")

    @property
    def words(self) -> list[str]:
        """The words in braces."""
        return [word[1:-1] for word in _ARGUMENT.findall(self.set + self.ask)]

    def read(self, reply: str) -> str:
        """Return a reply to its question as it is. Raises: ValueError for an empty one, and for bits that are none."""
        if not reply:
            raise ValueError("the reply is empty")
        if self.bits:
            int(reply)
        return reply

    def is_right(self, reply: str) -> bool:
        """Return whether a reply to its question, read, shows it right."""
        if self.bits:
            return not int(reply) & self.bits
        return replies_so(self.right, reply.upper().replace(" ", ""))


class Manual(StrictModel):
    """The file: ``commands`` by their form, each argument in braces: ``FREQ {frequency}``; ``states`` by their name."""

    instrument: str
    sources: dict[str, str]
    commands: dict[str, Command]
    states: dict[str, Condition] = Field({}, description="rows of the state table")

    @model_validator(mode="after")
    def _rows_that_hold_together(self) -> Manual:
        rows: list[tuple[str, Command | Condition]] = [*self.commands.items(), *self.states.items()]
        for name, row in rows:
            if not any(key in row.source for key in self.sources):
                raise ValueError(f"{name!r} cites none of the sources: {', '.join(self.sources)}")
        for name, condition in self.states.items():
            sent = [*condition.by, *(text for text in (condition.set, condition.ask) if text)]
            if strange := [text for text in sent if self.find(text) is None]:
                raise ValueError(f"{name!r} names {strange[0]!r}, which is none of the commands")
            if condition.ask and bool(condition.right) == bool(condition.bits):
                raise ValueError(f"{name!r} is asked by {condition.ask!r}: write what is right, or the bits of it")
            if not sent and not condition.why:
                raise ValueError(f"{name!r} is neither set nor asked: write why")
            if condition.ask and not condition.set and not (condition.why and condition.person):
                raise ValueError(f"{name!r} is refused where it is not right: write why, and what a person does")
        return self

    def find(self, sent: str) -> str | None:
        """Return the form of a command that was sent, that with most letters of its own; None if it is in none."""
        forms = [form for form in self.commands if _says(form, sent.strip(_CONTROLS))]
        return max(forms, key=lambda form: len(_ARGUMENT.sub("", form)), default=None)

    def in_order(self, options: Mapping[str, Any]) -> dict[str, Command]:
        """Return what a model with these options has, by form, in the order of a first contact: harmless first."""
        rows = sorted(self.commands.items(), key=lambda row: TOUCHES.index(row[1].touch))
        return {form: command for form, command in rows if command.of.items() <= options.items()}

    @property
    def unconfirmed(self) -> tuple[str, ...]:
        """Forms that neither a manual nor a public driver shows."""
        return tuple(form for form, command in self.commands.items() if command.state == "unconfirmed")


def _says(form: str, sent: str) -> bool:
    return re.fullmatch(".+?".join(re.escape(part) for part in _ARGUMENT.split(form)), sent) is not None


def manual_of(driver: str) -> Manual | None:
    """Return the table of a driver, None if it has none.

    Raises: InputErrors for a file that is not right, InstallationError B-LAB-004 of the lab folder.
    """
    return _manual_of(driver, _here())


@lru_cache(maxsize=64)
def _manual_of(driver: str, here: Path) -> Manual | None:
    if (own := lab.table_of(driver)) is not None:
        return parse_yaml(own, f"{driver}.yaml", Manual).model
    package = package_of_driver(driver)
    path = None if package is None else package.folder / f"{driver}.yaml"
    return parse_yaml(path.read_bytes(), path.name, Manual).model if path is not None and path.is_file() else None


def _here() -> Path:
    """Return the working directory, which decides on the lab folder."""
    try:
        return Path.cwd()
    except FileNotFoundError:  # somebody removed it
        return Path()


_PLAIN = re.compile(r"[a-z0-9_]{1,40}")


def driver_class(name: str) -> type:
    """Return the driver class of a module ``<name>``: of an installed package of drivers, or of the lab folder.

    Raises: InputError B-PLAN-010 if the name is not plain, B-PLAN-011 if there is no such driver, B-LAB-001;
            InstallationError, of the lab folder B-LAB-004 to B-LAB-006.
    """
    return _class_of(name, _here())


@lru_cache(maxsize=64)
def _class_of(name: str, here: Path) -> type:
    if not _PLAIN.fullmatch(name) or name.startswith("_"):
        raise InputError("B-PLAN-010", f"{name!r} is not a plain driver name (a-z, 0-9 and _)", where=name)
    package = package_of_driver(name)
    if lab.own_code("instruments", name) is not None:
        if package is not None:
            raise lab.refused_twice("instruments", name, package.offer.release)
        own = lab.load("instruments", name)
        assert own is not None
        module = own.__name__
    else:
        module = f"{package.offer.package}.{name}" if package is not None else ""
    driver = getattr(load(module), "DRIVER", None) if module else None
    if isinstance(driver, type):
        return driver
    if module and whose(module) is not None:
        raise unusable(module, "names no class as DRIVER")
    refuse_unknown(f"the driver {name!r}", name, driver_refusals())
    raise InputError("B-PLAN-011", f"there is no driver {name!r} in instruments/", where=name)
