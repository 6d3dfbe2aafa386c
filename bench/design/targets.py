"""Targets of a plan: which uncertainty of which quantity, and the floor that the standards set.

The random part is what no other result shares: the uncertainty without the errors of standards and campaign.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from bench.analysis import Estimate, Estimates
from bench.maths.verdict import coverage_factor
from bench.model.errors import InputError
from bench.model.units import read_quantity

RANDOM = "random"
_TARGET = re.compile(r"\s*(\w+)(\.random)?\s*=\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S*)\s*")
_SLACK = 1.0 + 1e-9
_ALIKE = 1.001  # of an uncertainty that is no larger, to the digits that anybody states


class Key(NamedTuple):
    """A quantity, the part of its uncertainty ("" all of it), and a kind of channels ("" all kinds)."""

    quantity: str
    part: str
    kind: str

    @property
    def name(self) -> str:
        """Return the key as a person writes it."""
        return f"{self.quantity}{'.' + self.part if self.part else ''}{f' ({self.kind})' if self.kind else ''}"


@dataclass(frozen=True)
class Target:
    """An expanded uncertainty (95 %) that a plan must reach, in the unit of its quantity."""

    key: Key
    U: float

    def takes_in(self, key: Key) -> bool:
        """Return whether the target is for what a key names."""
        return key[:2] == self.key[:2] and self.key.kind in ("", key.kind)

    def holds(self, known: Mapping[Key, float]) -> bool:
        """Return whether the largest uncertainty of the quantity does not exceed the target."""
        return self.reached(known) <= self.U * _SLACK

    def reached(self, known: Mapping[Key, float]) -> float:
        """Return the largest uncertainty of what the target takes in; infinite if there is nothing of it."""
        return max((U for key, U in known.items() if self.takes_in(key)), default=math.inf)


def reached(estimates: Estimates) -> dict[Key, float]:
    """Return the largest expanded uncertainty of each quantity and kind, all of it and its random part."""
    known: dict[Key, float] = {}
    for entry in _first_visits(estimates):
        kind = str(entry["conditions"].get("kind", ""))
        for part, U in (("", entry["expanded_uncertainty"]), (RANDOM, random_U(entry))):
            key = Key(entry["quantity"], part, kind)
            known[key] = max(known.get(key, 0.0), U)
    return known


def _first_visits(estimates: Estimates) -> list[Estimate]:
    """Return the estimates without those of repeats, of which no target is."""
    return [entry for entry in estimates if "repeat" not in entry["conditions"]]


def random_U(entry: Estimate) -> float:
    """Return the expanded uncertainty (95 %) of an estimate without what it shares with others, by its own factor."""
    common = entry.get("common")
    parts = [] if common is None else [*common["standards"].values(), *common["campaign"].values()]
    own = entry["std_uncertainty"] ** 2 - math.fsum(part**2 for part in parts)
    return entry["coverage_factor"] * math.sqrt(max(own, 0.0))


def read_target(text: str, estimates: Estimates) -> Target:
    """Read ``dsf_n=22ppm`` or ``dsf_n.random=0.6ppm``. Raises: InputError B-DES-001."""
    match = _TARGET.fullmatch(text)
    units = {entry["quantity"]: entry["unit"] for entry in _first_visits(estimates)}
    quantity, part, number, unit = match.groups() if match else ("", "", "0", "")
    if quantity not in units:
        message = f"{text!r} is no target of this campaign" if match else f"{text!r} is not QUANTITY=U"
        known = ", ".join(units)
        raise InputError("B-DES-001", message, where="--target", next_step=f"write QUANTITY=U of: {known}")
    U = _in_unit(number, unit, units[quantity])
    if not 0.0 < U < math.inf:
        message = f"{text!r} states no uncertainty above zero with a unit"
        step = f"write a number with the unit {units[quantity]}, or another of its kind"
        raise InputError("B-DES-001", message, where="--target", next_step=step)
    return Target(Key(quantity, RANDOM if part else "", ""), U)


def _in_unit(number: str, unit: str, due: str) -> float:
    """Return a number with a unit in the unit that is due, NaN without one or with one of another dimension."""
    if unit == due:
        return float(number)
    stated, one = read_quantity(f"{number} {unit}"), read_quantity(f"1 {due}")
    return stated[0] / one[0] if stated and one and stated[1] == one[1] else math.nan


def default_targets(wanted: Iterable[tuple[str, str]], known: Mapping[Key, float]) -> list[Target]:
    """Return as targets what a campaign reaches in the quantities that are wanted, of each kind, to a thousandth."""
    return [Target(key, _ALIKE * known[key]) for part in wanted for key in known if key[:2] == part]


def refuse_below_floor(targets: Iterable[Target], estimates: Estimates) -> None:
    """Refuse targets that no plan with these standards reaches. Raises: InputError B-DES-002 with the floor.

    The floor is what the errors of the standards alone leave; ``estimates``: of all given levels.
    """
    for target in targets:
        entries = [entry for entry in estimates if entry["quantity"] == target.key.quantity]
        for entry in [] if target.key.part else entries:
            common = entry.get("common")
            parts = common["standards"] if common is not None else {}
            floor = coverage_factor() * math.sqrt(math.fsum(part**2 for part in parts.values()))
            if floor > target.U:
                raise _below(target, floor, parts, entry["unit"])


def _below(target: Target, floor: float, parts: Mapping[str, float], unit: str) -> InputError:
    k, label = coverage_factor(), max(parts, key=lambda name: abs(parts[name]))
    others = k * math.sqrt(math.fsum(part**2 for name, part in parts.items() if name != label))
    message = (
        f"{target.key.name}={target.U:.6g} {unit} is below {floor:.3g} {unit}, which the standards alone leave; "
        f"{k * abs(parts[label]):.3g} {unit} of it is {label!r}"
    )
    if others < target.U:
        better = f"know {label!r} to {math.sqrt(target.U**2 - others**2):.3g} {unit}, or ask for {floor:.3g} {unit}"
    else:
        better = f"without it {others:.3g} {unit} would be left; ask for {floor:.3g} {unit}"
    return InputError("B-DES-002", message, where="--target", next_step=better)


def misses(targets: Sequence[Target], known: Mapping[Key, float]) -> list[str]:
    """Return the targets that are not reached, a sentence each."""
    return [
        f"{target.key.name} is {target.reached(known):.3g}, not {target.U:.3g}"
        for target in targets
        if not target.holds(known)
    ]
