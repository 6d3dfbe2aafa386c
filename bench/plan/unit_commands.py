"""Commands to the unit under test: from the words of a step to the bytes that are sent.

A command is one of ``unit_commands`` of the sequence (number and payload as they are), or one that the frame of the
link declares; that one takes arguments by name and is encoded here, so that a value that does not fit is found before
the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.frame import CommandLayout
from bench.model.errors import InputError
from bench.plan.expand import Expander, Path
from bench.plan.expected import reply_conditions
from bench.plan.findings import suggestion
from bench.plan.language.expect import ReplyExpect
from bench.plan.language.steps import Test, TestStep, UnitStep
from bench.plan.values import Quantity, Scope, named, plain


def expand_unit(plan: Expander, step: UnitStep, path: Path, scope: Scope) -> None:
    """Append a command that must be done, else the run ends."""
    link, called = next(iter(step.unit.items()))
    here = (*path, "unit", link)
    if not _takes_commands(plan, link, here):
        return
    name, arguments = (called, {}) if isinstance(called, str) else next(iter(called.items()))
    command = plan.document.model.unit_commands.get(name)
    layout = plan.layouts.get(link, {}).get(name)
    if command is not None and not arguments:
        payload = tuple(bytes.fromhex(command.payload))
        conditions = reply_conditions(plan, step.expect, (link, name), scope.context, path, scope)
        plan.add(
            "unit", link, name, {"command": command.code, "payload": payload}, scope, (*path, "unit"),
            conditions=conditions,
        )  # fmt: skip
    elif layout is not None:
        _append(plan, link, layout, arguments or {}, here, scope, {}, step.expect)
    else:
        _unknown(plan, name, link, here)


def expand_test(plan: Expander, step: TestStep, path: Path, scope: Scope) -> None:
    """Append a command whose outcome is judged when the session is analysed."""
    test: Test = step.test
    link = test.link or next(iter(plan.document.model.frame), "")
    here = (*path, "test", "command")
    if not _takes_commands(plan, link, here):
        return
    layout = plan.layouts.get(link, {}).get(test.command)
    if layout is None:
        _unknown(plan, test.command, link, here)
        return
    more: dict[str, Any] = {"item": test.item}
    if test.takes is not None:
        more["takes"] = plan.quantity(test.takes, "s", scope, (*path, "test", "takes"))
    _append(plan, link, layout, test.arguments, (*path, "test"), scope, more)


def _takes_commands(plan: Expander, link: str, path: Path) -> bool:
    frames = plan.document.model.frame
    if not frames:
        plan.fail("B-PLAN-097", path, "the step sends a command to the unit, and the sequence names no link to it")
        return False
    if link not in frames:
        plan.fail("B-PLAN-041", path, f"there is no link {link!r}{suggestion(link, frames)}")
        return False
    if link not in plan.command_links:
        plan.fail("B-PLAN-039", path, f"{link} takes no commands: frame {frames[link]!r} has no 'command' message")
    return True


def _unknown(plan: Expander, name: str, link: str, path: Path) -> None:
    if link not in plan.layouts:
        return  # its frame cannot be read, and says so once
    known = [*plan.document.model.unit_commands, *plan.layouts.get(link, {})]
    plan.fail(
        "B-PLAN-049", path, f"neither 'unit_commands' nor the frame of {link} has {name!r}{suggestion(name, known)}"
    )


def _append(
    plan: Expander, link: str, layout: CommandLayout, given: Mapping[str, Any], path: Path, scope: Scope,
    more: Mapping[str, Any], expect: ReplyExpect | None = None,
) -> None:  # fmt: skip
    values: dict[str, Any] = {}
    conditions = dict(scope.context)
    for name, raw in given.items():
        value = plan.resolve(raw, scope, (*path, "arguments", name))
        if value is None:
            return
        values[name] = f"{value.value!r} {value.dimension}" if isinstance(value, Quantity) else plain(value)
        conditions[named(name, value)] = plain(value)
    try:
        payload = layout.encode(values)
    except InputError as error:
        plan.fail("B-PLAN-091", path, f"command {layout.name!r}: {error.message}", error.next_step)
        return
    arguments = {"command": layout.code, "payload": tuple(payload), "timeout": layout.timeout_s, **more}
    conditions = reply_conditions(plan, expect, (link, layout.name), conditions, path[:-2], scope)
    plan.add("unit", link, layout.name, arguments, scope, path, conditions=conditions)
