"""A run as its own terminal shows it: the state document of its feed, in a few words."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.model.units import hours
from bench.run.feed.client import FeedClient, FeedGone

Document = Mapping[str, Any]


class Follower:
    """Asks the feed of a run for its state; an answer that does not come is none."""

    def __init__(self, folder: Path) -> None:
        self._client = FeedClient(folder)
        self._seq = 0

    def look(self) -> Document | None:
        """Return the state document of a run under way; None if nobody answers or it does not say where it is yet."""
        try:
            header = self._client.poll(self._seq).header
        except FeedGone:
            return None
        self._seq = header["seq"]  # no point is shown, so none is asked for twice
        found: Document = header["state"]
        return found if found.get("started_utc_s") is not None and found.get("step") else None

    def close(self) -> None:
        """Ask no more."""
        self._client.close()


def doing(document: Document) -> str:
    """What is going on: why the run stands still, else the step and, of a wait, its last reading and its time."""
    step, wait, now = document["step"], document.get("wait"), document["t_utc_s"]
    if document.get("holds"):
        reasons = "; ".join(f"{reason} ({by})" for by, reason in document["holds"].items())
        return f"HOLDING{_since(wait, now)}: {reasons}"
    where = f"step {step['number']}/{step['of']}"
    if wait is None:
        return f"{where}  {step['what']}"
    waiting = step["kind"] not in ("record", "settle")
    what = wait["reason"] if waiting else step["what"]
    last = f": {wait['last']}" if waiting and wait.get("last") else ""
    return f"{where}  {what}{last}{_since(wait, now)}"


def _since(wait: Document | None, now: float) -> str:
    """Return how long a wait has lasted, of how long."""
    if wait is None or wait.get("since_utc_s") is None:
        return ""
    since, until = wait["since_utc_s"], wait.get("until_utc_s")
    whole = "" if until is None else f" of {hours(until - since)}"
    return f", {hours(max(0.0, now - since))}{whole}"


def losses(document: Document) -> str:
    """Return frames lost and damaged, over all links."""
    links = (document.get("links") or {}).values()
    lost, bad = (sum(int(link.get(what) or 0) for link in links) for what in ("lost", "bad"))
    return f"{lost} lost" + (f", {bad} bad" if bad else "")


def ends(document: Document) -> str:
    """Return the end as a range, UTC; nothing for a rehearsal, whose time is not that of anybody."""
    eta = document.get("eta")
    if not eta or document.get("clock") != "wall":
        return ""
    likely, latest = (datetime.fromtimestamp(eta[f"{name}_utc_s"], tz=UTC) for name in ("likely", "latest"))
    now = datetime.fromtimestamp(document["t_utc_s"], tz=UTC)
    day = "" if likely.date() == now.date() else f"{likely:%m-%d} "
    return f"ends {day}{likely:%H:%M}Z, latest {latest:%H:%M}Z"
