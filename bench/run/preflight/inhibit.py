"""Keeps the machine awake while a run is on."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from bench.model.events import Inhibit
from bench.run.context import RunContext
from bench.run.preflight.of_machine import INHIBITOR

_REFUSED_S = 0.5
_END_S = 2.0
_WORDS = (INHIBITOR, "--what=sleep:idle:handle-lid-switch", "--who=bench", "--mode=block", "--why=a run is on", "cat")


@contextmanager
def stay_awake(context: RunContext, words: tuple[str, ...] = _WORDS) -> Iterator[None]:
    """Beside a run on the wall clock: an inhibitor of systemd, held by a program that ends with this process.

    Without systemd nothing is held; the pre-flight has said so. Writes an event "inhibit" {held, text}. A run whose
    inhibitor is refused goes on: the pre-flight judges, this only helps.
    """
    if context.clock.virtual or context.plan.station.in_process:
        yield
        return
    holder = _start(words)
    text = (
        f"nobody can be asked to keep the machine awake ({INHIBITOR})" if holder is None else "the machine stays awake"
    )
    context.event(Inhibit(held=holder is not None, text=text))
    try:
        yield
    finally:
        if holder is not None:
            _end(holder)


def _start(words: tuple[str, ...]) -> subprocess.Popen[bytes] | None:
    """The holder, alive; None if it is missing or refused. Its input is a pipe: it ends when this process does."""
    quiet = subprocess.DEVNULL
    try:
        holder = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet, start_new_session=True)
    except OSError:
        return None
    try:
        holder.wait(_REFUSED_S)
    except subprocess.TimeoutExpired:
        return holder
    assert holder.stdin is not None
    holder.stdin.close()
    return None


def _end(holder: subprocess.Popen[bytes]) -> None:
    assert holder.stdin is not None
    with suppress(OSError):
        holder.stdin.close()
    try:
        holder.wait(_END_S)
    except subprocess.TimeoutExpired:
        holder.kill()
        holder.wait()
