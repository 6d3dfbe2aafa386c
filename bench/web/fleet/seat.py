"""What the fleet page knows of one bench: what it said last, when, and from these two what may be claimed of it now.

Whoever has not been heard for ``SILENT_S`` is unknown, whatever it said before: a heartbeat may be late by 1.5 s, no
more, so that the page says so within 5 s. What comes from a bench is cut to known keys and plain values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from bench.model.clock import NS, Clock
from bench.web.fleet.fleet_file import FleetBench
from bench.web.fleet.overview import ATTENTION, MOST_RUNS, PROTO
from bench.web.now import number_of
from bench.web.recorded.listing import RUN_NAME

SILENT_S = 3.5
UNKNOWN, IDLE = "unknown", "idle"
CONNECTING, UNREACHED, SILENT, REFUSED, UNTRUSTED, MISNAMED, FOREIGN = (
    "connecting", "unreached", "silent", "refused", "untrusted", "misnamed", "foreign",
)  # fmt: skip
LONGEST_TEXT = 300
MOST_ALARMS = 3
OUTPUTS = ("energised", "moving", "unknown", "off")  # of several the first one is the state of their bench
_TEXTS = ("title", "state", "what", "waits", "asks", "guard", "outputs", "unconfirmed", "outcome")
_NUMBERS = ("progress", "end_utc_s", "alarm_count")

Card = dict[str, Any]


class NotUnderstood(ValueError):
    """A message that is not of this protocol."""


class Seat:
    """One bench among others. For one event loop."""

    def __init__(self, bench: FleetBench, clock: Clock) -> None:
        self.bench = bench
        self._clock = clock
        self._heard_ns: int | None = None
        self._heard_utc_s: float | None = None
        self._why = CONNECTING
        self._said: Card = {"state": IDLE}
        self._card: Card = {}
        self._known: bool | None = None  # what the card was made for

    def hear(self, document: object) -> None:
        """Take what it says of its runs. Raises: NotUnderstood."""
        if not isinstance(document, Mapping) or document.get("proto") != PROTO:
            raise NotUnderstood("another protocol")
        self._said = _said(document)
        self._known = None
        self.beat()

    def beat(self) -> None:
        """Take a sign of life: what it said last is still true."""
        self._heard_ns = self._clock.now_ns()

    def lose(self, why: str) -> None:
        """Nobody is there any more: unknown at once."""
        if self._heard_ns is not None:
            self._heard_utc_s = self._clock.utc_ns() / NS - self.age_s
        self._heard_ns, self._why, self._known = None, why, None

    @property
    def age_s(self) -> float:
        """Time since it was heard, s; infinite for one that is not heard."""
        return math.inf if self._heard_ns is None else (self._clock.now_ns() - self._heard_ns) / NS

    def card(self) -> Card:
        """Return what may be said of it now; the same object as long as nothing has changed."""
        is_known = self.age_s <= SILENT_S
        if self._known != is_known:
            self._known = is_known
            named = {"name": self.bench.name, "place": self.bench.place, "url": self.bench.url}
            self._card = {**named, **(self._said if is_known else self._unknown())}
        return self._card

    def _unknown(self) -> Card:
        heard_utc_s = self._heard_utc_s if self._heard_ns is None else self._clock.utc_ns() / NS - self.age_s
        last: Card = {key: self._said[key] for key in ("run", "title", "uut", "simulated") if key in self._said}
        why = self._why if self._heard_ns is None else SILENT
        return {**last, "state": UNKNOWN, "attention": "much", "why": why, "heard_utc_s": heard_utc_s}


def _said(document: Mapping[str, Any]) -> Card:
    """Return the run that needs somebody most, and how many more there are; the newest session where none goes on.

    What is on is that of the whole bench: the worst of all its runs.
    """
    runs = document.get("runs")
    entries = list(runs.items())[:MOST_RUNS] if isinstance(runs, Mapping) else []
    cards = [_run(name, entry) for name, entry in entries if isinstance(entry, Mapping) and _is_run(name)]
    last = _last(document.get("last"))
    if last is not None and (not cards or (last["off"] is False and last["run"] > max(card["run"] for card in cards))):
        cards.append(last)  # it ended behind the others, and not all of it was confirmed off
    cards.sort(key=lambda card: card["run"], reverse=True)
    cards.sort(key=lambda card: (_is_put_away(card), ATTENTION.index(card["attention"])))
    if not cards:
        return {"state": IDLE, "attention": "none"}
    told = [card["outputs"] if card["outputs"] in OUTPUTS else "unknown" for card in cards if card["outputs"]]
    return {**cards[0], "more": len(cards) - 1, "outputs": min(told, key=OUTPUTS.index, default=None)}


def _last(entry: object) -> Card | None:
    """Return the newest session that is over; None if the bench tells of none."""
    if not isinstance(entry, Mapping) or not _is_run(entry.get("run")):
        return None
    off = entry.get("off")
    return {**_run(entry["run"], entry), "state": IDLE, "off": off if isinstance(off, bool) else None}


def _is_put_away(card: Card) -> bool:
    """Return whether a run is gone and its guard has confirmed all of it off: a run that goes on stands before it."""
    return (card["state"], card["outputs"]) == ("stopped", "off")


def _is_run(name: object) -> bool:
    return isinstance(name, str) and RUN_NAME.fullmatch(name) is not None


def _run(name: str, entry: Mapping[str, Any]) -> Card:
    """Return one run with known keys and plain values; None where there is none."""
    uut = entry.get("uut")
    alarms = entry.get("alarms")
    attention = entry.get("attention")
    return {
        "run": name,
        **{key: _text(entry.get(key)) for key in _TEXTS},
        **{key: number_of(entry.get(key)) for key in _NUMBERS},
        "uut": {key: _text(uut.get(key)) for key in ("model", "serial")} if isinstance(uut, Mapping) else None,
        "simulated": entry.get("simulated") is True,
        "attention": attention if attention in ATTENTION else "much",
        "alarms": [
            {key: _text(alarm.get(key)) for key in ("severity", "code", "text")}
            for alarm in (alarms if isinstance(alarms, list) else [])[:MOST_ALARMS]
            if isinstance(alarm, Mapping)
        ],
    }


def _text(value: object) -> str | None:
    return None if value is None else str(value).encode("utf-8", "replace").decode()[:LONGEST_TEXT]
