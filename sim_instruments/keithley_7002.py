"""Simulated Keithley 7002 switch system with 7012 4 x 10 two-pole matrix cards.

``:CLOS`` adds crosspoints to those already closed; nothing in the instrument keeps two routes apart. A scan opens its
channel and closes the next one of its list; a continuous one does so until ``:INIT:CONT OFF`` and ``:ABOR``. A card of
another type is not addressed by row and column, a forbidden channel not closed; with four poles a relay has a pair.

Source: Keithley 7001/7002 instruction manuals (ROUTe and trigger subsystems, channel lists ``(@slot!row!column)``),
7012 card (4 rows, 10 columns, 1 A); public programs (``:CONF:SLOT1:CTYP?``, ``STIM?``, ``POLE``, ``:SCAN``,
``:TRIG:DEL``, ``:DISP:ENAB``). Placeholders: a scan goes on once a second; the contacts move at once, ``*OPC?`` waits
15 ms for them; reply of ``:CLOS:STAT?`` as a list of single crosspoints in order; ``:FCH`` and the number of its error;
that the pair of a relay is that two rows below.
"""

from __future__ import annotations

import re
from functools import partial
from itertools import product
from typing import Any

from sim_instruments.bus.scpi import (
    MISSING_PARAMETER,
    SETTINGS_CONFLICT,
    Handlers,
    ScpiDevice,
    ScpiError,
    command,
)

ROWS, COLUMNS, SLOTS = 4, 10, 10
RELAY_S, SCAN_S = 0.015, 1.0
CARD = "C7012"
_POINT = re.compile(r"(\d+)!(\d+)!(\d+)")
_CELLS = tuple(product(range(1, ROWS + 1), range(1, COLUMNS + 1)))
_SLOT = """
[:ROUTe]:CONFigure:SLOT#:CTYPe |  | C7012
[:ROUTe]:CONFigure:SLOT#:POLE  |  | 2  | 1 4
[:ROUTe]:CONFigure:SLOT#:STIMe |  | 0. | 0 99999.999
"""
_LAYER = """
#:SOURce |  | IMM | IMMediate, BUS, EXTernal, TIMer, MANual
#:COUNt  |  | 1   | 1 99999 INF
#:DELay  |  | 0.  | 0 99999.999
"""

Point = tuple[int, int, int]


class Keithley7002(ScpiDevice):
    """Relay matrix; slot ``options["slot"]`` (1 by default) is the card that is wired to the bench, or several are.

    The columns of a further card are wired behind those of the cards before it.
    """

    identity = "KEITHLEY INSTRUMENTS INC.,MODEL 7002,SIM7002,A03 /A02"
    no_error = '0,"No error"'
    error_format = '{0},"{1}"'
    queue_length = 10
    settings = """
:INITiate:CONTinuous | continuous! | OFF
[:ROUTe]:SCAN        | scan_list!  | - | by points | -
[:ROUTe]:FCHannels   | forbidden   | - | by points | -
:DISPlay:ENABle      |             | ON
:OUTPut:TTL1         |             | OFF
:TRIGger:COUNt:AUTO  |             | OFF
"""
    settings += "".join(_LAYER.replace("#", layer) for layer in (":ARM:LAYer1", ":ARM:LAYer2", ":TRIGger"))
    settings += "".join(_SLOT.replace("#", str(slot)) for slot in range(1, SLOTS + 1))

    def power_up(self) -> None:
        self.closed: set[Point] = set()
        slots = self.options.get("slot", 1)
        self._slots = [int(slot) for slot in (slots if isinstance(slots, list) else [slots])]
        super().power_up()

    def reset(self) -> None:
        self.scan_list: set[Point] = set()
        self.forbidden: set[Point] = set()
        self._scanning = False
        if self.closed:
            self._move(set())

    def _apply(self) -> None:
        if self.continuous:
            self._start("")

    @command(":INITiate")
    def _start(self, _: str) -> None:
        if self.scan_list and not self._scanning:
            self._scanning = True
            self._step(0)

    def _step(self, place: int) -> None:
        """Close the next channel of the scan list alone."""
        self._scanning &= self.continuous or place < len(self.scan_list)
        if self._scanning:
            self._move({sorted(self.scan_list)[place % len(self.scan_list)]})
            self.world.after(SCAN_S, lambda: self._step(place + 1))

    @command(":ABORt")
    def _abort(self, _: str) -> None:
        """Back to idle, which a continuous initiation leaves at once."""
        self._scanning &= self.continuous

    def outputs(self) -> dict[str, Any]:
        return {"closed": ["!".join(map(str, point)) for point in sorted(self.closed)]}

    def _move(self, closed: set[Point]) -> None:
        self.closed = closed
        places = {slot: COLUMNS * place for place, slot in enumerate(self._slots)}
        wired = frozenset((row, places[slot] + column) for slot, row, column in closed)
        self.world.wiring.switch(wired, self.now_ns)
        self.busy(RELAY_S)

    def of_slot(self, slot: int, setting: str) -> str:
        """Return a setting of a slot as it is told."""
        return str(getattr(self, f"[:ROUTe]:CONFigure:SLOT{slot}:{setting}"))

    def points(self, text: str) -> set[Point]:
        """Return crosspoints of a channel list; a range runs over columns, then rows, inside one card."""
        if not text:
            raise ScpiError(*MISSING_PARAMETER)
        if not (text.startswith("(@") and text.endswith(")")):
            raise ScpiError(-104, "Data type error")
        points: set[Point] = set()
        for item in text[2:-1].replace(" ", "").split(","):
            ends = [self._point(end) for end in item.split(":")]
            if len(ends) > 2 or ends[0][0] != ends[-1][0]:
                raise ScpiError(-102, "Syntax error")
            first, last = min(ends), max(ends)
            points |= {(first[0], *cell) for cell in _CELLS if first[1:] <= cell <= last[1:]}
        return points

    def _point(self, text: str) -> Point:
        match = _POINT.fullmatch(text)
        if match is None:
            raise ScpiError(-102, "Syntax error")
        slot, row, column = (int(part) for part in match.groups())
        there = slot in self._slots and 1 <= row <= ROWS and 1 <= column <= COLUMNS
        if not there or self.of_slot(slot, "CTYPe") != CARD:
            raise ScpiError(-222, "Parameter data out of range")
        return slot, row, column

    @command("[:ROUTe]:CLOSe")
    def _close(self, text: str) -> None:
        points = self.points(text)
        if points & self.forbidden:
            raise ScpiError(*SETTINGS_CONFLICT)
        pairs = {
            (slot, (row + 1) % ROWS + 1, column) for slot, row, column in points if self.of_slot(slot, "POLE") == "4"
        }
        self._move(self.closed | points | pairs)

    @command("[:ROUTe]:OPEN:ALL")
    def _open_all(self, _: str) -> None:
        self._move(set())

    @command("[:ROUTe]:OPEN")
    def _open(self, text: str) -> None:
        self._move(set() if text.upper() == "ALL" else self.closed - self.points(text))

    def further(self) -> Handlers:
        lists = {"CLOSe:STATe": "closed", "SCAN": "scan_list", "FCHannels": "forbidden"}
        return {
            **{f"[:ROUTe]:{header}?": partial(self._tell_list, attribute) for header, attribute in lists.items()},
            "[:ROUTe]:CLOSe?": partial(self._tell_closed, True),
            "[:ROUTe]:OPEN?": partial(self._tell_closed, False),
        }

    def _tell_list(self, attribute: str, _: str) -> str:
        return f"(@{','.join('!'.join(map(str, point)) for point in sorted(getattr(self, attribute)))})"

    def _tell_closed(self, closed: bool, text: str) -> str:
        return ",".join(str(int((point in self.closed) is closed)) for point in sorted(self.points(text)))


SIMULATOR = Keithley7002
