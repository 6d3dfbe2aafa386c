"""The fits that a sequence asks for, for the manifest: names as the values have them, limits in base units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bench.plan.expected import bound_in, limits_in, takes_all
from bench.plan.language.expect import LOG, NONLINEARITY, RECIPROCAL, Fit, variable_of
from bench.plan.values import Scope

if TYPE_CHECKING:
    from bench.plan.expand import Expander, Path

TIME = "time"


def fits_of(plan: Expander, scope: Scope) -> list[dict[str, Any]]:
    """Return the fits for the manifest (B-PLAN-120, B-PLAN-121, B-PLAN-123)."""
    fits: list[dict[str, Any]] = []
    for index, fit in enumerate(plan.document.model.fits if takes_all(plan) else ()):
        path: Path = ("fits", index)
        of, function = variable_of(fit.of)
        unit = plan.expected.unit_of(of)
        if unit is None:
            _unknown(plan, of, (*path, "of"))
            continue
        y_unit, against = _unit_of(plan, fit.of, unit, (*path, "of")), _against(plan, fit, path)
        per = [_per(plan, name, (*path, "per", place)) for place, name in enumerate(fit.per)]
        if against is None or y_unit is None or None in per:
            continue
        x_unit = _unit_of(plan, fit.against, against["unit"], (*path, "against"))
        if x_unit is None:
            continue
        units = {**coefficient_units(y_unit, x_unit, fit.orders), NONLINEARITY: unit}
        expected = {
            result: limits_in(plan, bounds, units[result], (*path, "expect", result), scope)
            for result, bounds in fit.expect.items()
        }
        asked = {"name": fit.name, "of": of, "powers": list(fit.orders), "per": per, "units": units,
                 "against": against, "expected": expected}  # fmt: skip
        asked |= {"function": function} if function else {}
        read_back = _read_back(plan, fit, unit, against["unit"], path, scope)
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


def _unit_of(plan: Expander, variable: str, unit: str, path: Path) -> str | None:
    """Return the unit of a function of a quantity (B-PLAN-123 for a logarithm of degrees)."""
    _, function = variable_of(variable)
    if function == LOG:
        if unit == "degC":
            message = f"{variable}: a temperature in degC has no logarithm, because its zero is arbitrary"
            plan.fail("B-PLAN-123", path, message, "fit the temperature itself, or 1/x of it, which is in kelvin")
            return None
        return "1"
    if function == RECIPROCAL and unit != "1":
        return "1/K" if unit == "degC" else f"1/{unit}"
    return unit


def _against(plan: Expander, fit: Fit, path: Path) -> dict[str, Any] | None:
    if fit.against == TIME:
        return {"time": True, "unit": "s"}
    name, function = variable_of(fit.against)
    unit, condition = plan.expected.unit_of(name), plan.expected.condition(name)
    more = {"function": function} if function else {}
    if unit is not None:
        return {"quantity": name, "unit": unit, **more}
    if condition is None:
        _unknown(plan, name, (*path, "against"))
        return None
    against: dict[str, Any] = {"condition": condition[0], "unit": condition[1], **more}
    stated = fit.against_uncertainty
    if stated is not None:
        value = bound_in(plan, stated, condition[1], (*path, "against_uncertainty"))
        against |= {} if value is None else {"uncertainty": value}
    return against


def _read_back(
    plan: Expander, fit: Fit, unit: str, against: str, path: Path, scope: Scope
) -> list[dict[str, Any]]:  # fmt: skip
    """Return the values of the curve that have a name, in the units of the quantities themselves."""
    entries = []
    for index, asked in enumerate(fit.read_back):
        here = (*path, "read_back", index)
        at = bound_in(plan, asked.at, against, (*here, "at"), scope)
        if asked.name in plan.expected.names:
            message = f"{asked.name!r} is read, and cannot be the name of a value of a fit"
            plan.fail("B-PLAN-121", (*here, "name"), message, "give it a name of its own")
        elif at is not None:
            limits = limits_in(plan, asked, unit, here, scope)
            entries.append({"quantity": asked.name, "at": at, "unit": unit, **limits})
    return entries


def _per(plan: Expander, name: str, path: Path) -> str | None:
    condition = plan.expected.condition(name)
    if condition is None:
        _unknown(plan, name, path)
    return None if condition is None else condition[0]


def _unknown(plan: Expander, name: str, path: Path) -> None:
    known = ", ".join(plan.expected.names) or "nothing"
    message = f"no value and no condition of one is called {name!r}"
    plan.fail("B-PLAN-123", path, message, f"what is read: {known}; write 'expect: {{name: ...}}' beside a reading")
