"""A living run, drawn in Jupyter out of its own feed: no page server is needed, and nothing of it reaches the run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any

from bench.model.clock import WallClock
from bench.model.errors import InputError
from bench.model.extras import extras_named, optional
from bench.plan import suggestion
from bench.record import OPEN_MARKER, is_being_written
from bench.run.control.client import FeedClient, FeedGone, FeedReply

PERIOD_S = 1.0


def watch(path: str | Path, signal: str) -> None:
    """Draw the last minute of a signal of a living run below a cell of a notebook, each second until the run has ended.

    The figure spans the least and the greatest value of each 0.1 s on the clock of the bench; its title is the step of
    the run. Interrupting the cell changes nothing in the run.

    Args:   path: of the session's folder.   signal: as in the graphs of a station: ``port_a.npp[1]``, ``bench.unit``.
    Raises: InputError B-RUN-100 if no run of this session answers, at once or because it died; B-TAB-010 (no such
            signal), B-TAB-011 (no Jupyter), B-PKG-005 (matplotlib missing).
    """
    display = optional("IPython.display", InputError(
        "B-TAB-011", "a living run is drawn in Jupyter, and IPython is not installed", where="watch",
        next_step="call it in a notebook; 'bench top' shows a run in a terminal",
    ))  # fmt: skip
    handle = display.DisplayHandle()
    show = handle.display
    for reply in _replies(Path(path)):
        show(display.Image(_picture(reply, signal)))
        show = handle.update


def _replies(folder: Path) -> Iterator[FeedReply]:
    """Yield what the run says, each second until it has ended; one that is busy is waited for. Raises: FeedGone."""
    clock = WallClock()
    with closing(FeedClient(folder)) as feed:
        yield feed.poll(0)
        while (folder / OPEN_MARKER).exists():
            clock.sleep(PERIOD_S)
            try:
                reply = feed.poll(0)
            except FeedGone:
                if (folder / OPEN_MARKER).exists() and not is_being_written(folder):
                    raise
            else:
                yield reply


def _picture(reply: FeedReply, signal: str) -> bytes:
    """Return the figure as PNG. Raises: InputError B-TAB-010, B-PKG-005."""
    with extras_named():
        from matplotlib.figure import Figure

    state = reply.header["state"]
    units = {str(entry["name"]): str(entry["unit"]) for entry in state["signals"]}
    if signal not in units:
        raise InputError(
            "B-TAB-010", f"the run has no signal {signal!r}{suggestion(signal, units)}", where=str(state["run"]),
            next_step=f"use one of: {', '.join(units)}",
        )  # fmt: skip
    column, t_s = list(units).index(signal), reply.t_utc_s - state["t_utc_s"]
    figure = Figure(figsize=(8, 2.5), layout="constrained")
    axes = figure.subplots()
    axes.fill_between(t_s, reply.low[:, column], reply.high[:, column], linewidth=1)
    axes.set(xlabel="bench time / s", ylabel=f"{signal} / {units[signal]}", title=_title(state))
    packed = BytesIO()
    figure.savefig(packed, format="png")
    return packed.getvalue()


def _title(state: dict[str, Any]) -> str:
    return str((state["step"] or {}).get("what", state["state"]))
