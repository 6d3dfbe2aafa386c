"""Commands to the unit under test: from the words of a step to the bytes that are sent.

A command is one of ``unit_commands`` of the sequence (number and payload as they are), or one that the frame of the
link declares; that one takes arguments by name and is encoded here, so that a value that does not fit is found before
the run.
"""

from __future__ import annotations

from typing import Any

from bench.frame import CommandLayout
from bench.model.errors import InputError
from bench.model.quantities import Values
from bench.plan.expand import Node
from bench.plan.expected import reply_conditions
from bench.plan.findings import suggestion
from bench.plan.language.expect import ReplyExpect
from bench.plan.language.steps import Test, TestStep, UnitStep
from bench.plan.values import Quantity, named, plain


def expand_unit(node: Node, step: UnitStep) -> None:
    """Append a command that must be done, else the run ends."""
    link, called = next(iter(step.unit.items()))
    own, plan = node.below("unit"), node.plan
    here = own.below(link)
    if not _takes_commands(here, link):
        return
    name, arguments = (called, {}) if isinstance(called, str) else next(iter(called.items()))
    command = plan.model.unit_commands.get(name)
    layout = plan.layouts.get(link, {}).get(name)
    if command is not None and not arguments:
        payload = tuple(bytes.fromhex(command.payload))
        conditions = reply_conditions(node, step.expect, (link, name), node.scope.context)
        plan.add(own, "unit", link, name, {"command": command.code, "payload": payload}, conditions=conditions)
    elif layout is not None:
        _append(here, node, link, layout, arguments or {}, {}, step.expect)
    else:
        _unknown(here, name, link)


def expand_test(node: Node, step: TestStep) -> None:
    """Append a command whose outcome is judged when the session is analysed."""
    test: Test = step.test
    link, own = test.link or node.plan.link, node.below("test")
    here = own.below("command")
    if not _takes_commands(here, link):
        return
    layout = node.plan.layouts.get(link, {}).get(test.command)
    if layout is None:
        _unknown(here, test.command, link)
        return
    more: dict[str, Any] = {"item": test.item}
    if test.takes is not None:
        more["takes"] = own.quantity(test.takes, "s", "takes")
    _append(own, node, link, layout, test.arguments, more)


def _takes_commands(node: Node, link: str) -> bool:
    frames = node.plan.model.frame
    if not frames:
        node.fail("B-PLAN-097", "the step sends a command to the unit, and the sequence names no link to it")
        return False
    if link not in frames:
        node.fail("B-PLAN-041", f"there is no link {link!r}{suggestion(link, frames)}")
        return False
    if link not in node.plan.command_links:
        node.fail("B-PLAN-039", f"{link} takes no commands: frame {frames[link]!r} has no 'command' message")
    return True


def _unknown(node: Node, name: str, link: str) -> None:
    plan = node.plan
    if link not in plan.layouts:
        return  # its frame cannot be read, and says so once
    known = [*plan.model.unit_commands, *plan.layouts.get(link, {})]
    message = f"neither 'unit_commands' nor the frame of {link} has {name!r}{suggestion(name, known)}"
    node.fail("B-PLAN-049", message)


def _append(
    node: Node, step: Node, link: str, layout: CommandLayout, given: Values, more: Values,
    expect: ReplyExpect | None = None,
) -> None:  # fmt: skip
    values: dict[str, Any] = {}
    conditions = dict(node.scope.context)
    for name, raw in given.items():
        value = node.resolve(raw, "arguments", name)
        if value is None:
            return
        values[name] = f"{value.value!r} {value.dimension}" if isinstance(value, Quantity) else plain(value)
        conditions[named(name, value)] = plain(value)
    try:
        payload = layout.encode(values)
    except InputError as error:
        node.fail("B-PLAN-091", f"command {layout.name!r}: {error.message}", error.next_step)
        return
    arguments = {"command": layout.code, "payload": tuple(payload), "timeout": layout.timeout_s, **more}
    conditions = reply_conditions(step, expect, (link, layout.name), conditions)
    node.plan.add(node, "unit", link, layout.name, arguments, conditions=conditions)
