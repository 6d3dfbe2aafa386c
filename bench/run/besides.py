"""Everything that watches over a run beside its sequencer, put together for ``conduct(beside=...)``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager

from bench.plan import Plan
from bench.run.context import RunContext
from bench.run.control.asking import WaitingOperator
from bench.run.control.channel import Control
from bench.run.control.early import early_verdicts
from bench.run.control.live import live_feed
from bench.run.control.notify import notifications, user_notify
from bench.run.control.systemd import service_notice
from bench.run.session import Beside
from bench.run.watch.deviations import deviations
from bench.run.watch.outputs import outputs_watch
from bench.run.watch.trend import trend_recorder


def besides(
    plan: Plan, environment: Mapping[str, str], *, virtual: bool, asking: WaitingOperator | None = None
) -> list[Beside]:
    """Return trend, feed, interlocks, deviations; on the wall clock socket, early verdicts, notices, service manager.

    Args:   virtual: a rehearsal, in which nobody is told anything and nobody interferes, so that the same seed gives
            the same bytes.   asking: who waits for answers to prompts; None if nobody is asked.
    Raises: InputErrors if the user's notify.yaml is wrong; it counts where the station has no section ``notify``.
    """
    notify = None if virtual else plan.station.file.notify or user_notify(environment)

    @contextmanager
    def beside(context: RunContext) -> Iterator[None]:
        if asking is not None:
            asking.attach(context)
        with ExitStack() as stack:
            stack.enter_context(trend_recorder(context))
            feed = stack.enter_context(live_feed(context, asking))
            stack.enter_context(context.interlocks.watching())
            stack.enter_context(outputs_watch(context))
            stack.enter_context(deviations(context, plan.interlocks))
            if not virtual:
                if notify is not None:
                    stack.enter_context(notifications(context, notify, feed.bench_line, feed.state.is_shelved))
                control = Control(context, feed.state, asking)
                stack.enter_context(control.listening())
                if plan.early is not None:
                    stack.enter_context(early_verdicts(context, plan.early))
                stack.enter_context(service_notice(context, environment))
            yield

    return [beside]
