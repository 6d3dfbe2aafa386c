"""Simulated Keithley 7002 switch system with 7012 4 x 10 two-pole matrix cards.

``:CLOS`` adds crosspoints to those already closed; nothing in the instrument keeps two routes apart. A scan that the
last user left running opens its channel and closes the next one until ``:INIT:CONT OFF`` and ``:ABOR``.

Source: Keithley 7001/7002 instruction manuals (ROUTe and trigger subsystems, channel lists ``(@slot!row!column)``),
7012 card (4 rows, 10 columns, 1 A). Placeholders: a scan goes on once a second; the contacts move at once, ``*OPC?``
waits 15 ms for them; reply of ``:CLOS:STAT?`` as a list of single crosspoints in order.
"""

from __future__ import annotations

import re
from typing import Any, ClassVar

import numpy as np

from sim_instruments.bus.kept import HeldSettings, held_switch
from sim_instruments.bus.scpi import MISSING_PARAMETER, ScpiDevice, ScpiError, command

ROWS, COLUMNS = 4, 10
RELAY_S, SCAN_S = 0.015, 1.0
_POINT = re.compile(r"(\d+)!(\d+)!(\d+)")

Point = tuple[int, int, int]


class Keithley7002(ScpiDevice):
    """Relay matrix; slot ``options["slot"]`` (1 by default) is the card that is wired to the bench, or several are.

    The columns of a further card are wired behind those of the cards before it.
    """

    identity = "KEITHLEY INSTRUMENTS INC.,MODEL 7002,SIM7002,A03 /A02"
    no_error = '0,"No error"'
    error_format = '{0},"{1}"'
    queue_length = 10
    held: ClassVar[HeldSettings] = {":INITiate:CONTinuous": held_switch("_continuous", None)}

    def power_up(self) -> None:
        self._closed: set[Point] = set()
        self._scanning = self._continuous = False
        super().power_up()
        slots = self.options.get("slot", 1)
        self._slots = [int(slot) for slot in (slots if isinstance(slots, list) else [slots])]

    def reset(self) -> None:
        self._scanning = self._continuous = False
        if self._closed:
            self._move(set())

    def leave_more(self, draw: np.random.Generator) -> None:
        points = {
            (self._slots[0], int(draw.integers(1, ROWS + 1)), int(draw.integers(1, COLUMNS + 1))) for _ in range(5)
        }
        self._move(set(list(points)[: int(draw.integers(5))]))
        self._scanning = self._continuous = bool(draw.integers(2))
        self._scan(1)

    def _scan(self, column: int) -> None:
        if self._scanning:
            self._move({(self._slots[0], 1, column)})
            self.world.after(SCAN_S, lambda: self._scan(column % COLUMNS + 1))

    def outputs(self) -> dict[str, Any]:
        return {"closed": ["!".join(map(str, point)) for point in sorted(self._closed)]}

    def _move(self, closed: set[Point]) -> None:
        self._closed = closed
        places = {slot: COLUMNS * place for place, slot in enumerate(self._slots)}
        wired = frozenset((row, places[slot] + column) for slot, row, column in closed)
        self.world.wiring.switch(wired, self.now_ns)
        self.busy(RELAY_S)

    def _points(self, text: str) -> set[Point]:
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
            first, last = ends[0], ends[-1]
            order = sorted([first[1:], last[1:]])
            cells = [(row, column) for row in range(1, ROWS + 1) for column in range(1, COLUMNS + 1)]
            points |= {(first[0], *cell) for cell in cells if order[0] <= cell <= order[1]}
        return points

    def _point(self, text: str) -> Point:
        match = _POINT.fullmatch(text)
        if match is None:
            raise ScpiError(-102, "Syntax error")
        slot, row, column = (int(part) for part in match.groups())
        if slot not in self._slots or not 1 <= row <= ROWS or not 1 <= column <= COLUMNS:
            raise ScpiError(-222, "Parameter data out of range")
        return slot, row, column

    @staticmethod
    def _listed(points: set[Point]) -> str:
        return f"(@{','.join('!'.join(map(str, point)) for point in sorted(points))})"

    @command(":ABORt")
    def _abort(self, _: str) -> None:
        """Back to idle, which a continuous initiation leaves at once."""
        self._scanning = self._continuous

    @command("[:ROUTe]:CLOSe")
    def _close(self, text: str) -> None:
        self._move(self._closed | self._points(text))

    @command("[:ROUTe]:OPEN")
    def _open(self, text: str) -> None:
        self._move(set() if text.upper() == "ALL" else self._closed - self._points(text))

    @command("[:ROUTe]:OPEN:ALL")
    def _open_all(self, _: str) -> None:
        self._move(set())

    @command("[:ROUTe]:CLOSe:STATe?")
    def _closed_list(self, _: str) -> str:
        return self._listed(self._closed)

    @command("[:ROUTe]:CLOSe?")
    def _is_closed(self, text: str) -> str:
        return ",".join("1" if point in self._closed else "0" for point in sorted(self._points(text)))

    @command("[:ROUTe]:OPEN?")
    def _is_open(self, text: str) -> str:
        return ",".join("0" if point in self._closed else "1" for point in sorted(self._points(text)))


SIMULATOR = Keithley7002
