"""Standing still: the stimulus is off, everything else stays as it is, until nobody wants it any more."""

from __future__ import annotations

from bench.model.clock import NS
from bench.model.errors import RunError
from bench.model.ports import Effect, actions_of
from bench.run.context import RunContext
from bench.run.holds import Wish

POLL_S = 0.25
LIMIT_S = 4 * 3600.0
_STIMULUS = (Effect.STIMULUS_ON, Effect.ROUTE)


def stand_still(context: RunContext, wish: Wish, step: int) -> int:
    """Switch the stimulus off and wait until the last reason to hold is gone; returns how long, ns.

    Raises: RunError B-RUN-070 when it lasts longer than ``LIMIT_S``; OperatorStop; the fault of another thread.
    """
    began_ns = context.clock.now_ns()
    context.event("hold", step=step, by=wish.by, reason=wish.reason)
    context.listener.message(f"holding at step {step}: {wish.reason} ({wish.by}); the stimulus is off")
    for role in context.plan.station.safe_order:
        instrument = context.instruments.get(role)
        if instrument is not None and drives(type(instrument)):
            instrument.make_safe()
    while context.stop.holds.reasons:
        context.stop.check_stop()
        if context.clock.now_ns() - began_ns > LIMIT_S * NS:
            raise RunError(
                "B-RUN-070",
                f"held for more than {LIMIT_S:g} s: {wish.reason}",
                where=wish.by,
                next_step="remove the cause, then 'bench resume SESSION'",
            )
        context.clock.sleep(POLL_S)
    held_ns = context.clock.now_ns() - began_ns
    context.event("release", step=step, seconds=held_ns / NS)
    context.listener.message(f"going on after {held_ns / NS:.0f} s")
    return held_ns


def drives(driver: type) -> bool:
    """True for an instrument that drives a stimulus or leads it to the unit."""
    return any(action.effect in _STIMULUS for action in actions_of(driver).values())
