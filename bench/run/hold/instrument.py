"""An instrument that has fallen silent: the run stands still until it answers again, instead of ending in the night.

The bus session has climbed its whole ladder by then. Only an instrument outside the stimulus is waited for: when the
calibrator or the switch cannot be told to be safe the run ends.
"""

from __future__ import annotations

from bench.model.errors import InstrumentError
from bench.model.events import by_instrument
from bench.run.context import RunContext
from bench.run.hold.holds import Wish

SILENT = ("B-INST-001", "B-INST-003", "B-INST-004")  # no answer, the bus failed, a reply that is not understood
ASK_S = 5.0
LIMIT_S = 1800.0
MOST_HOLDS = 3  # at one step: an instrument that answers its identity and never the step will not get better


def wish_to_wait(context: RunContext, error: InstrumentError, role: str, held_before: int) -> Wish:
    """Hold the run because of an instrument; ``ask_again`` releases it when the instrument identifies itself again.

    Raises: the error itself if it is no silence, if the run may not be interrupted, or after ``MOST_HOLDS``.
    """
    if error.code not in SILENT or not context.stop.interruptible or held_before >= MOST_HOLDS:
        raise error
    wish = Wish("hold", by_instrument(role), f"{error.code}: {error.message}")
    context.stop.holds.hold(wish.by, wish.reason, LIMIT_S)
    context.away.add(role)
    return wish


def ask_again(context: RunContext) -> None:
    """Ask the instruments that are waited for who they are, on the thread of the steps.

    A thread of its own would climb its ladder with the bus held, and keep the steps from making a stimulus safe; the
    guard would take them for hanging. Raises: InstrumentError if another one answers; what ``stop.check_stop`` raises.
    """
    for role in sorted(context.away):
        context.stop.check_stop()
        try:
            with context.in_use.take(role):
                context.instruments[role].identify()
        except InstrumentError as still:
            if still.code not in SILENT:
                raise
        else:
            context.away.discard(role)
            context.stop.holds.release(by_instrument(role))
