"""Pause, resume, abort, acknowledge, shelve, answer and status of a living run, from another terminal or the live page.

One line of JSON asks, one answers: ``{"command": "pause", "reason": "..."}``. Every command becomes an event "control",
done or refused, with its result; ``by`` says for whom the one who asks speaks, ``place`` whether that one is at the
bench (anything but "bench" is afar). A pause holds the run for a day at most; ``resume`` takes back every hold that a
person may take back, from afar only while every interlock is inside its limits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from bench.model import events
from bench.model.clock import NS
from bench.run.context import RunContext
from bench.run.control.asking import Refused, WaitingOperator
from bench.run.control.local_socket import ControlServer, forget_socket, socket_path
from bench.run.feed.run_state import RunState
from bench.run.operator import AFAR, BENCH

OPERATOR, EARLY = "operator", "early verdict"
RELEASABLE = (OPERATOR, EARLY, events.DECISION, events.UNDECLARED)  # an interlock is released by its value
PAUSE_LIMIT_S = 24 * 3600.0
LONGEST_REASON = 500
LONGEST_NAME = 100
MOST_REFUSED = 1000  # events of refused commands in one run: no client may fill a disk
ABOUT = {"acknowledge": ("alarm",), "shelve": ("alarm",), "answer": ("prompt", "value")}  # what else the event says
COMMANDS = ("status", "pause", "resume", "abort", "acknowledge", "shelve", "answer")
LEAST_SHELVED_S, MOST_SHELVED_S = 60.0, 8 * 3600.0  # a shift: whoever comes then decides anew


class Refusal(Exception):
    """A command that is understood and cannot be done now; its text says why."""


@dataclass(frozen=True)
class _Order:
    """A command that is understood: why and by whom it is given, and all of the request."""

    command: str
    reason: str
    by: str
    request: Mapping[str, Any]


class Control:
    """Answers the commands for one run.

    ``state`` has the alarms of the feed, ``asking`` the prompt.
    """

    def __init__(
        self,
        context: RunContext,
        state: RunState | None = None,
        asking: WaitingOperator | None = None,
    ) -> None:
        self._context = context
        self._state, self._asking = state, asking
        self._refused = 0

    def answer(self, request: dict[str, Any], peer: str) -> dict[str, Any]:
        """Return the reply to one request; it never waits and never raises for what a client sends."""
        request = {key: _written(value) for key, value in request.items()}
        command, reason, name = request.get("command"), request.get("reason", ""), request.get("by", "")
        if command not in COMMANDS:
            return _no(f"{str(command)[:40]!r} is no command; known: {', '.join(COMMANDS)}")
        if command == "status":
            return {"ok": True, **self.status()}
        if not isinstance(reason, str) or len(reason) > LONGEST_REASON or not reason.isprintable():
            return _no(f"a reason is one line of at most {LONGEST_REASON} printable characters")
        if not isinstance(name, str) or len(name) > LONGEST_NAME or not name.isprintable():
            return _no(f"'by' is a name of at most {LONGEST_NAME} printable characters")
        return self._ordered(_Order(command, reason.strip(), f"{name} via {peer}" if name else peer, request))

    def _ordered(self, order: _Order) -> dict[str, Any]:
        """Do a command that is understood, and journal it with what came of it."""
        command, request = order.command, order.request
        do: dict[str, Callable[[_Order], str]] = {
            "pause": self._pause, "resume": self._resume, "abort": self._abort, "acknowledge": self._acknowledge,
            "shelve": self._shelve, "answer": self._answer,
        }  # fmt: skip
        about = {key: request[key] for key in ABOUT.get(command, ()) if isinstance(request.get(key), str | int | float)}
        if command == "shelve" and _is_number(request.get("seconds")):
            about["until_utc_s"] = self._context.clock.utc_ns() / NS + float(request["seconds"])
        told = events.Control(what=command, by=order.by, reason=order.reason, place=_place(request), **about)
        try:
            if self._context.stop.over:
                raise Refusal("the run is ending already, its bench is being made safe")
            text = do[command](order)
        except Refusal as why:
            self._refused += 1
            if self._refused <= MOST_REFUSED:
                self._context.note(replace(told, ok=False, text=str(why)))
            return _no(str(why))
        self._context.note(replace(told, ok=True, text=text))
        if command in ("pause", "abort"):  # the event comes before what it does
            self._carry_out(order)
        return {"ok": True, "text": text, "holding": bool(self._context.stop.holds.reasons)}

    def _carry_out(self, order: _Order) -> None:
        if order.command == "pause":
            self._context.stop.holds.hold(OPERATOR, f"{order.reason} ({order.by})", PAUSE_LIMIT_S)
        else:
            self._context.stop.request(f"abort by {order.by}{f': {order.reason}' if order.reason else ''}")

    def _pause(self, order: _Order) -> str:
        if not order.reason:
            raise Refusal("a pause needs a reason; whoever finds the run standing still must know why")
        if not self._context.stop.interruptible:
            raise Refusal("the bench is being put away at the end of the run, which is not interrupted")
        return "the run holds at its next check; its stimulus goes off"

    def _resume(self, order: _Order) -> str:
        """Take the holds of people back; whoever does so at the bench has armed it for what follows."""
        holds, at_bench = self._context.stop.holds, _place(order.request) == BENCH
        if holds.reasons and not at_bench and (trouble := self._context.interlocks.in_the_way()):
            raise Refusal(f"not resumed from afar, an interlock is beyond its limit: {'; '.join(trouble.values())}")
        released = holds.let_go(RELEASABLE, armed_by=order.by if at_bench else "")
        still = holds.reasons
        if not released and not still:
            raise Refusal("the run is not holding")
        if still:
            return f"still holding: {'; '.join(still.values())}"
        return "the run goes on" if at_bench else "the run goes on, once the bench is armed where that is due"

    def _abort(self, _: _Order) -> str:
        return "the run ends at its next check and makes the bench safe"

    def _acknowledge(self, order: _Order) -> str:
        alarm = order.request.get("alarm")
        if self._state is None or not isinstance(alarm, str) or not self._state.waits(alarm):
            raise Refusal("there is no such alarm that waits to be acknowledged")
        return f"alarm {alarm} is acknowledged"

    def _shelve(self, order: _Order) -> str:
        now_s = self._context.clock.utc_ns() / NS
        alarm, seconds = order.request.get("alarm"), order.request.get("seconds")
        if not order.reason:
            raise Refusal("an alarm is shelved for a reason; whoever comes next must know why")
        if not _is_number(seconds) or not LEAST_SHELVED_S <= float(str(seconds)) <= MOST_SHELVED_S:
            raise Refusal(f"an alarm is shelved for {LEAST_SHELVED_S:g} s to {MOST_SHELVED_S / 3600.0:g} h")
        known = [] if self._state is None else self._state.alarm_documents(now_s)
        found = next((each for each in known if each["id"] == alarm), None)
        if found is None:
            there = "; ".join(f"{each['id']}: {each['text'][:80]}" for each in known) or "none"
            raise Refusal(f"there is no alarm {str(alarm)[:40]!r}; there are: {there}")
        if found["severity"] == "fault":
            raise Refusal(f"alarm {alarm} is a fault, which is never shelved")
        until = datetime.fromtimestamp(now_s + float(str(seconds)), UTC)
        return f"alarm {alarm} is shelved until {until:%Y-%m-%dT%H:%M:%SZ}; nobody is notified of it until then"

    def _answer(self, order: _Order) -> str:
        request, prompt = order.request, order.request.get("prompt")
        if self._asking is None:
            raise Refusal("nobody is asked anything in this run")
        if not isinstance(prompt, str | None):
            raise Refusal("a prompt is named by its id, a text")
        try:
            return self._asking.propose(prompt, request.get("value"), order.by, _place(request))
        except Refused as why:
            raise Refusal(str(why)) from why

    def status(self) -> dict[str, Any]:
        """Return where the run is, why it stands still, what it has and what it asks; its feed has all of it."""
        stop, step = self._context.stop, self._context.step
        holding, ending = stop.holds.reasons, stop.over or bool(stop.requested) or stop.fault is not None
        return {
            "state": "ending" if ending else "holding" if holding else "running",
            "step": None if step is None else step.number,
            "reasons": holding,
            "records": len(self._context.measured),
            "prompt": None if self._asking is None else self._asking.document(lambda t_ns: t_ns / NS),
        }

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Answer other terminals, on the wall clock; a socket that cannot be made keeps no run back."""
        context = self._context
        try:
            path = socket_path(context.folder)
            server = ControlServer(path, self.answer, context.clock)
        except OSError as error:
            context.message(f"no control from another terminal: {error}")
            yield
            return
        if self._asking is not None:
            self._asking.reachable = True
        try:
            yield
        finally:
            server.close()
            forget_socket(context.folder, path)


def _written(value: Any) -> Any:
    """Return a text as it can be journaled: half a character, of another encoding, keeps no abort back."""
    return value.encode(errors="replace").decode() if isinstance(value, str) else value


def _place(request: Mapping[str, Any]) -> str:
    return BENCH if request.get("place") == BENCH else AFAR


def _is_number(value: object) -> bool:
    """Return whether a JSON value is a number that a time can be made of."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= PAUSE_LIMIT_S


def _no(why: str) -> dict[str, Any]:
    return {"ok": False, "error": why}
