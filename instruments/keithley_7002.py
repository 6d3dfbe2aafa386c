"""Keithley 7002 switch system with 7012 4x10 matrix cards: column = channel, row 1 = direct, row 2 = reversed.

One card leads to one unit; the rows of several are joined over the backplane, so that one source reaches all of them.

``:CLOS`` only adds crosspoints, so nothing in the instrument keeps two routes apart; this driver does: it opens all,
verifies, closes one crosspoint and verifies that exactly that one is closed.

Source: Keithley 7001/7002 instruction manuals, ROUTe subsystem; two-pole matrix addressing ``(@slot!row!column)``.
Not confirmed on hardware: the 250 ms allowance for relays (from public drivers), and that ``:CLOS:STAT?`` lists single
crosspoints and never a range; a range is treated as a wrong state.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any, ClassVar

from bench.model.errors import InstrumentError
from bench.model.ports import Effect, Figure, Parameter, Tells, action
from instruments.commands import ReadBack
from instruments.scpi import ScpiInstrument

_RELAYS_S = 0.25
_DIRECT_ROW, _REVERSED_ROW = 1, 2
_SLOTS = 10
_NOT_CLOSED = ("B-INST-005", "B-INST-011")  # it is refused, or something else is closed
_LOOK_AT_CARD = (  # what no question is confirmed for stands here
    "look in its menu of cards for a card pair, four poles, another card type or a forbidden channel, "
    "then check the card, its slot and its wiring"
)


def read_closed(reply: str) -> tuple[str, ...]:
    """Return closed crosspoints of a ``:CLOS:STAT?`` reply, ``"(@1!1!3)" -> ("1!1!3",)``. Raises: ValueError."""
    compact = reply.replace(" ", "")
    if not (compact.startswith("(@") and compact.endswith(")")):
        raise ValueError("a channel list (@...) is due")
    return tuple(item for item in compact[2:-1].split(",") if item)


def cards_of(options: Mapping[str, Any]) -> tuple[int, ...]:
    """Return the slots of the cards: the option ``slot`` is one of them, or a list."""
    slots = options["slot"]
    return tuple(slots) if isinstance(slots, list) else (slots,)


class Keithley7002(ScpiInstrument):
    """Control of the relay matrix; at most one route is closed at any time."""

    identity_pattern = r"KEITHLEY.*,7002"
    safe_state = "all relays open (:OPEN ALL), confirmed by :CLOS:STAT?"
    default_options: ClassVar[dict[str, Any]] = {"slot": 1}
    tells = Tells(
        {":CLOS:STAT?": lambda reply: bool(read_closed(reply))}, {":CLOS:STAT?": Figure("closed", "", read_closed)}
    )

    routed: tuple[str, ...] | None = None  # closed crosspoints as this run has verified them

    @action(
        Parameter("channel", choices=tuple(range(1, 11))),
        Parameter("polarity", choices=(1, -1)),
        Parameter("card", choices=tuple(range(1, _SLOTS + 1)), required=False),
        effect=Effect.ROUTE,
        bus_s=0.9,
    )
    def route(self, channel: int, polarity: int, card: int | None = None) -> None:
        """Set the one closed route: current into ``channel``, reversed by the wiring of row 2 for polarity -1.

        ``card``: the slot of one of several cards; the only one if left out.
        Raises: InstrumentError B-INST-008 (also a card that is not there), B-INST-015 if the relays do not read back as
                meant (all are opened then).
        """
        cards = cards_of(self.options)
        if card is None and len(cards) == 1:
            card = cards[0]
        if card not in cards:
            raise self.refusal(f"route: card {card} is none of {cards}")
        self.open_all()
        crosspoint = f"{card}!{_DIRECT_ROW if polarity == 1 else _REVERSED_ROW}!{channel}"
        self.routed = None
        try:
            self.set(f":CLOS (@{crosspoint})", ReadBack(self.closed, (crosspoint,).__eq__, ().__eq__))
        except InstrumentError as error:
            if error.code in _NOT_CLOSED:
                error.next_step = _LOOK_AT_CARD
            raise
        self.clock.sleep(_RELAYS_S)
        if (closed := self.closed()) != (crosspoint,):
            with suppress(InstrumentError):
                self.bus.write(":OPEN ALL", self.timeout_s)
            message = f"closed are {', '.join(closed) or 'none'} instead of {crosspoint} alone"
            raise self.error("B-INST-015", message, _LOOK_AT_CARD)
        self.routed = closed

    @action(effect=Effect.ROUTES_OPEN, bus_s=0.5)
    def open_all(self) -> None:
        """Set every relay open and verify it. Raises: InstrumentError B-INST-005, B-INST-015."""
        self.routed = None
        self.set(":OPEN ALL", ReadBack(self.closed, ().__eq__, lambda _: True))  # opening again only makes safer
        self.clock.sleep(_RELAYS_S)
        if closed := self.closed():
            message = f"{', '.join(closed)} still closed after :OPEN ALL; no route was closed"
            raise self.error("B-INST-015", message, "check the card and its slot")
        self.routed = closed

    @action()
    def closed(self) -> tuple[str, ...]:
        """Get the closed crosspoints as "slot!row!column"."""
        return self.ask(":CLOS:STAT?", read_closed)

    @classmethod
    def wrong_option(cls, options: Mapping[str, Any]) -> tuple[str, str] | None:
        slots = cards_of(options)
        valid = bool(slots) and all(type(slot) is int and 1 <= slot <= _SLOTS for slot in slots)
        return None if valid else ("slot", f"slot {options['slot']!r} is no whole number from 1 to {_SLOTS}")

    def _recheck(self) -> None:
        if self.routed is not None and (closed := self.closed()) != self.routed:
            message = f"closed are {', '.join(closed) or 'none'}, but {', '.join(self.routed) or 'none'} was verified"
            raise self.error("B-INST-015", message, "look for another controller or a front panel in use")

    def _forget(self) -> None:
        self.routed = None

    def _safe_command(self) -> str:
        return ":OPEN ALL"

    def _go_safe(self) -> None:
        self.routed = None
        if not self.switch_off(":OPEN ALL", self._all_open):
            raise self.error("B-INST-009", "relays are still closed after :OPEN ALL", "switch the matrix off")

    def _all_open(self) -> bool:
        self.clock.sleep(_RELAYS_S)
        return not self.closed()


DRIVER = Keithley7002
