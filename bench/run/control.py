"""Pause, resume, abort and status of a living run from another terminal.

One line of JSON asks, one answers: ``{"command": "pause", "reason": "..."}``. Every command becomes an event "control".
A pause holds the run for a day at most; ``resume`` takes back every hold that a person may take back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any

from bench.model.clock import NS
from bench.run.context import RunContext
from bench.run.control_place import forget_socket, socket_path
from bench.run.control_server import ControlServer
from bench.run.following import Following

OPERATOR, EARLY = "operator", "early verdict"
RELEASABLE = (OPERATOR, EARLY)  # an interlock releases by itself, when its value is back
PAUSE_LIMIT_S = 24 * 3600.0
LONGEST_REASON = 500
COMMANDS = ("status", "pause", "resume", "abort")


class Control:
    """Answers the commands for one run. ``alarms`` gives what is beyond its limit now, by name."""

    def __init__(self, context: RunContext, following: Following, alarms: Callable[[], Mapping[str, str]]) -> None:
        self._context = context
        self._following = following
        self._alarms = alarms

    def answer(self, request: dict[str, Any], by: str) -> dict[str, Any]:
        """The reply to one request; it never waits and never raises for what a client sends."""
        command, reason = request.get("command"), request.get("reason", "")
        if command not in COMMANDS:
            return _no(f"{str(command)[:40]!r} is no command; known: {', '.join(COMMANDS)}")
        if command == "status":
            return {"ok": True, **self.status()}
        if not isinstance(reason, str) or len(reason) > LONGEST_REASON:
            return _no(f"a reason is a text of at most {LONGEST_REASON} characters")
        if self._context.stop.over:
            return _no("the run is ending already, its bench is being made safe")
        if command == "pause":
            return self._pause(reason.strip(), by)
        return self._resume(by) if command == "resume" else self._abort(reason.strip(), by)

    def _pause(self, reason: str, by: str) -> dict[str, Any]:
        if not reason:
            return _no("a pause needs a reason; whoever finds the run standing still must know why")
        if not self._context.stop.interruptible:
            return _no("the bench is being put away at the end of the run, which is not interrupted")
        self._context.event("control", what="pause", by=by, reason=reason)
        self._context.stop.holds.hold(OPERATOR, f"{reason} ({by})", PAUSE_LIMIT_S)
        return {"ok": True, "text": "the run holds at its next check; its stimulus goes off"}

    def _resume(self, by: str) -> dict[str, Any]:
        released = [one for one in RELEASABLE if self._context.stop.holds.release(one)]
        still = self._context.stop.holds.reasons
        if not released and not still:
            return _no("the run is not holding")
        self._context.event("control", what="resume", by=by, reason="")
        text = f"still holding: {'; '.join(still.values())}" if still else "the run goes on"
        return {"ok": True, "text": text, "holding": bool(still)}

    def _abort(self, reason: str, by: str) -> dict[str, Any]:
        self._context.event("control", what="abort", by=by, reason=reason)
        self._context.stop.request(f"abort by {by}{f': {reason}' if reason else ''}")
        return {"ok": True, "text": "the run ends at its next check and makes the bench safe"}

    def status(self) -> dict[str, Any]:
        """What the run does now, as JSON values."""
        context, step = self._context, self._following.step_under_way
        holding = context.stop.holds.reasons
        ending = context.stop.over or bool(context.stop.requested) or context.stop.fault is not None
        return {
            "session": context.folder.name,
            "state": "ending" if ending else "holding" if holding else "running",
            "step": None if step is None else step.number,
            "steps": len(context.plan.steps),
            "phase": None if step is None else step.phase,
            "what": "" if step is None else f"{step.kind} {step.role} {step.name}".strip(),
            "conditions": {} if step is None else dict(step.conditions),
            "reasons": holding,
            "planned_end_utc": self._planned_end(),
            "records": len(self._following.records),
            "records_planned": context.plan.record_count,
            "links": self._links(),
            "alarms": dict(self._alarms()),
        }

    def _planned_end(self) -> str | None:
        """When the last step ends by plan and by the slip so far; a hold shifts it further."""
        context, step = self._context, self._following.step_under_way
        if step is None:
            return None
        lengths_s = {"campaign": context.plan.duration_s, "finally": context.plan.finally_s}
        lengths_s["prepare"] = context.plan.prepare_s
        order = ("prepare", "campaign", "finally")
        later_s = sum(lengths_s[phase] for phase in order[order.index(step.phase) + 1 :])
        left_ns = context.timeline.target_ns(lengths_s[step.phase] + later_s) - context.clock.now_ns()
        end = datetime.fromtimestamp((context.clock.utc_ns() + max(0, left_ns)) // NS, UTC)
        return f"{end:%Y-%m-%dT%H:%M:%SZ}"

    def _links(self) -> dict[str, dict[str, Any]]:
        found = {}
        for name, link in self._context.acquisition.status().items():
            age_s = None if math.isnan(link.age_s) else round(link.age_s, 3)
            counts = {"frames": link.frames, "lost": link.lost, "bad": link.bad}
            found[name] = {"state": link.state, **counts, "age_s": age_s}
        return found


@contextmanager
def control(context: RunContext, following: Following, alarms: Callable[[], Mapping[str, str]]) -> Iterator[Control]:
    """Answer other terminals, on the wall clock; a socket that cannot be made keeps no run back."""
    answering = Control(context, following, alarms)
    try:
        path = socket_path(context.folder)
        server = ControlServer(path, answering.answer, context.clock)
    except OSError as error:
        context.listener.message(f"no control from another terminal: {error}")
        yield answering
        return
    try:
        yield answering
    finally:
        server.close()
        forget_socket(context.folder, path)


def _no(why: str) -> dict[str, Any]:
    return {"ok": False, "error": why}
