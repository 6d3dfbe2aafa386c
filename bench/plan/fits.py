"""The fits that a sequence asks for, for the manifest: names as the values have them, limits in base units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bench.model.declaration import stated
from bench.plan.expand import Node
from bench.plan.expected import bound_in, limits_in, takes_all
from bench.plan.language.expect import LOG, NONLINEARITY, RECIPROCAL, Fit, variable_of

TIME = "time"


def fits_of(outer: Node) -> list[dict[str, Any]]:
    """Return the fits for the manifest (B-PLAN-120, B-PLAN-121, B-PLAN-123)."""
    fits: list[dict[str, Any]] = []
    plan = outer.plan
    for index, fit in enumerate(plan.model.fits if takes_all(plan) else ()):
        node = outer.below("fits", index)
        of, function = variable_of(fit.of)
        unit = plan.expected.unit_of(of)
        if unit is None:
            _unknown(node.below("of"), of)
            continue
        y_unit, against = _unit_of(node.below("of"), fit.of, unit), _against(node, fit)
        per = [_per(node.below("per", place), name) for place, name in enumerate(fit.per)]
        if against is None or y_unit is None or None in per:
            continue
        x_unit = _unit_of(node.below("against"), fit.against, against["unit"])
        if x_unit is None:
            continue
        units = {**coefficient_units(y_unit, x_unit, fit.orders), NONLINEARITY: unit}
        expected = {
            result: limits_in(node.below("expect", result), bounds, units[result])
            for result, bounds in fit.expect.items()
        }
        asked = {"name": fit.name, "of": of, "powers": list(fit.orders), "per": per, "units": units,
                 "against": against, "expected": expected}  # fmt: skip
        asked |= {"function": function} if function else {}
        read_back = _read_back(node, fit, unit, against["unit"])
        fits.append(asked | ({"read_back": read_back} if read_back else {}))
    return fits


def coefficient_units(of: str, against: str, orders: Sequence[int]) -> dict[str, str]:
    """Return the units of the coefficients c0, c1, ... that a polynomial has."""
    units = {}
    for order in orders:
        power = against if order == 1 else f"{against}{order}"
        units[f"c{order}"] = of if against == "1" or not order else f"1/{power}" if of == "1" else f"{of}/{power}"
        if of == against and order:
            units[f"c{order}"] = "1" if order == 1 else f"1/{against}{'' if order == 2 else order - 1}"
    return units


def _unit_of(node: Node, variable: str, unit: str) -> str | None:
    """Return the unit of a function of a quantity (B-PLAN-123 for a logarithm of degrees)."""
    _, function = variable_of(variable)
    if function == LOG:
        if unit == "degC":
            message = f"{variable}: a temperature in degC has no logarithm, because its zero is arbitrary"
            node.fail("B-PLAN-123", message, "fit the temperature itself, or 1/x of it, which is in kelvin")
            return None
        return "1"
    if function == RECIPROCAL and unit != "1":
        return "1/K" if unit == "degC" else f"1/{unit}"
    return unit


def _against(node: Node, fit: Fit) -> dict[str, Any] | None:
    if fit.against == TIME:
        return {"time": True, "unit": "s"}
    name, function = variable_of(fit.against)
    plan = node.plan
    unit, condition = plan.expected.unit_of(name), plan.expected.condition(name)
    more = {"function": function} if function else {}
    if unit is not None:
        return {"quantity": name, "unit": unit, **more}
    if condition is None:
        _unknown(node.below("against"), name)
        return None
    against: dict[str, Any] = {"condition": condition[0], "unit": condition[1], **more}
    value = bound_in(plan.node(*node.path, "against_uncertainty"), fit.against_uncertainty, condition[1])
    return against | stated({"uncertainty": value})


def _read_back(node: Node, fit: Fit, unit: str, against: str) -> list[dict[str, Any]]:
    """Return the values of the curve that have a name, in the units of the quantities themselves."""
    entries = []
    for index, asked in enumerate(fit.read_back):
        here = node.below("read_back", index)
        at = bound_in(here.below("at"), asked.at, against)
        if asked.name in node.plan.expected.names:
            message = f"{asked.name!r} is read, and cannot be the name of a value of a fit"
            here.below("name").fail("B-PLAN-121", message, "give it a name of its own")
        elif at is not None:
            limits = limits_in(here, asked, unit)
            entries.append({"quantity": asked.name, "at": at, "unit": unit, **limits})
    return entries


def _per(node: Node, name: str) -> str | None:
    condition = node.plan.expected.condition(name)
    if condition is None:
        _unknown(node, name)
    return None if condition is None else condition[0]


def _unknown(node: Node, name: str) -> None:
    known = ", ".join(node.plan.expected.names) or "nothing"
    message = f"no value and no condition of one is called {name!r}"
    node.fail("B-PLAN-123", message, f"what is read: {known}; write 'expect: {{name: ...}}' beside a reading")
