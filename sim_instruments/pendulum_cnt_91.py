"""Simulated time tagger of the CNT-91 class, its inputs on the comparators of a ring laser where the bench has one.

Source: CNT-90/91 Programmer's Handbook (INPut; 8-50: the level is automatic after *RST; INITiate, ABORt,
STATus:OPERation:CONDition?). The STReam commands are
not of the handbook; instruments/pendulum_cnt_91.py says what they mean. Placeholders: memory for 3 s of full blocks,
no limit of edges per second but 6,000 in 10 ms, a clock that can be changed only while nothing is measured.
"""

from __future__ import annotations

from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from bench.model.arrays import Integers, Octets
from bench.model.clock import NS
from sim_instruments.bus.scpi import OUT_OF_RANGE, SETTINGS_CONFLICT, Answers, ScpiDevice, ScpiError, command
from sim_instruments.bus.time_tag_blocks import TagBlocks

CLOCKS_HZ = (10_000_000, 20_000_000, 50_000_000, 100_000_000)
MEASUREMENT_STARTED = 16  # operation status
INIT_IGNORED = (-213, "Init ignored")
_PS = 10**12
FILTER_PS = 1_600_000  # delay of the low-pass of 100 kHz
_INPUT = """
:INPut#:COUPling    | coupling_#      | AC  | AC, DC
:INPut#:SLOPe       | slope_#         | POS | POSitive, NEGative
:INPut#:IMPedance   | impedance_ohm_# | 1E6 | 50 1E6 OHM     | .1E
:INPut#:ATTenuation | attenuation_#   | 1.  | 1 10           | g
:INPut#:FILTer      | filtered_#      | OFF
:INPut#:LEVel:AUTO  | automatic_#     | ON
:INPut#:LEVel       | level_V_#       | 0.  | by _read_level | +.8E
"""
_OF_INPUT = ("level_V", "slope", "filtered", "coupling", "impedance_ohm", "attenuation", "automatic")
_HIGH_V = 5.0  # of the comparators
_LEVEL_STEP_V = 0.0025
_SLICE_NS = NS  # events are asked for in such pieces, so that a long silence needs no more memory than a short one
_MOST_BYTES = 10_000_000

Events = tuple[Integers, Octets, Octets, Octets]


@runtime_checkable
class EdgeSource(Protocol):
    """A world whose comparators the tagger's inputs are wired to."""

    @property
    def edges_epoch_ns(self) -> int:
        """Bench time at which the picoseconds are 0."""

    def edges_until(self, t_ns: int) -> Events:
        """Return events before ``t_ns`` not handed out yet, in order: picoseconds, channel, level, cosine level."""

    def skip_edges(self, t_ns: int) -> None:
        """Nobody looked at the events before ``t_ns``."""


class PendulumCnt91(ScpiDevice):
    """Tagger; option ``clock_error_ppm``: how much faster than nominal its clock runs."""

    identity = "PENDULUM, CNT-91, 919191, V1.28 02 Mar 2017"
    answers: ClassVar[Answers] = {
        ":STATus:OPERation:CONDition?": lambda self: str(MEASUREMENT_STARTED if self.running else 0),
    }
    settings = """
:INITiate:CONTinuous?          | continuous | OFF
:ARM:SOURce                    | arming     | IMM  | IMMediate, EXT1, EXT2, EXT4
:ARM:SLOPe                     |            | POS  | POSitive, NEGative
:FORMat                        |            | ASC  | ASCii, REAL, PACKed
:FORMat:SMAX?                  |            | 10000
:CALibration:INTerpolator:AUTO |            | ON
[:SENSe]:ACQuisition:APERture  |            | 0.01 | 20E-9 1000 S
:STReam:CLOCk?                 | clock_Hz   | 10000000
"""
    settings += "".join(_INPUT.replace("#", str(number)) for number in (1, 2))

    def power_up(self) -> None:
        self.blocks = TagBlocks()
        self._seen_ns = 0  # until when the inputs were looked at
        super().power_up()
        self._clock_error = float(self.options.get("clock_error_ppm", 0.0)) * 1e-6

    def reset(self) -> None:
        self.running = False
        self.blocks.clear()

    def _read_level(self, text: str) -> float:
        return round(self.number(text, -5.0, 5.0, "V") / _LEVEL_STEP_V) * _LEVEL_STEP_V

    def outputs(self) -> dict[str, Any]:
        return {"measuring": self.running}

    # --- the stream --------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        source, self._seen_ns = self._source, self.now_ns
        if source is not None:
            source.skip_edges(self._seen_ns)
        self.blocks.start(self.clock_Hz, self._tick_now(self._seen_ns))
        self.running = True

    def _catch_up(self) -> None:
        """Stamp what has happened until now."""
        now_ns, source = self.now_ns, self._source
        while self.running and self._seen_ns < now_ns:
            self._seen_ns = min(now_ns, self._seen_ns + _SLICE_NS)
            if source is not None:
                t_ps, channel, level, cosine = self._stamped(*source.edges_until(self._seen_ns))
                flags = level.astype(np.uint32) | cosine.astype(np.uint32) << 1 | channel.astype(np.uint32) << 2
                self.blocks.add(self._ticks(t_ps), flags)
            self.blocks.close_until(self._tick_now(self._seen_ns))

    def _stamped(self, t_ps: Integers, channel: Octets, *levels: Octets) -> Events:
        """Return what the inputs make of the edges of comparators that switch between 0 and 5 V.

        A level that they do not cross, a divider by ten, a coupling without dc, a load of 50 ohm and an arming signal
        that does not come lose them all; the other slope turns the levels over, the filter delays the edges.
        """
        late_ps, level, lost = np.zeros(t_ps.size, np.int64), levels[0].copy(), np.full(t_ps.size, self.arming != "IMM")
        for number in (1, 2):
            level_V, slope, filtered, *plain = (getattr(self, f"{name}_{number}") for name in _OF_INPUT)
            mine = channel == number - 1
            if plain != ["DC", 1e6, 1.0, False] or not 0.0 <= level_V < _HIGH_V:
                lost |= mine
            late_ps[mine] = FILTER_PS * filtered
            level[mine] ^= np.uint8(slope == "NEG")
        return (t_ps + late_ps)[~lost], channel[~lost], level[~lost], levels[1][~lost]

    @property
    def _source(self) -> EdgeSource | None:
        return self.world if isinstance(self.world, EdgeSource) else None

    def _ticks(self, t_ps: Integers) -> Integers:
        own_ps = t_ps + np.floor(t_ps * self._clock_error).astype(np.int64) if self._clock_error else t_ps
        return own_ps // (_PS // self.clock_Hz)

    def _tick_now(self, t_ns: int) -> int:
        epoch_ns = 0 if self._source is None else self._source.edges_epoch_ns
        return int(self._ticks(np.array([(t_ns - epoch_ns) * (_PS // NS)]))[0])

    @command(":INITiate[:IMMediate]")
    def _initiate(self, _: str) -> None:
        if self.running:
            raise ScpiError(*INIT_IGNORED)
        self._begin()

    @command(":ABORt")
    def _abort(self, _: str) -> None:
        self._catch_up()
        self.running = False
        self._go_on()

    @command(":INITiate:CONTinuous")
    def _set_continuous(self, text: str) -> None:
        self.continuous = self.boolean(text)
        self._go_on()

    def _go_on(self) -> None:
        if self.continuous and not self.running:
            self._begin()

    @command(":STReam:CLOCk")
    def _set_clock(self, text: str) -> None:
        if self.running:
            raise ScpiError(*SETTINGS_CONFLICT)
        clock_Hz = self.number(text, CLOCKS_HZ[0], CLOCKS_HZ[-1])
        if clock_Hz not in CLOCKS_HZ:
            raise ScpiError(*OUT_OF_RANGE)
        self.clock_Hz = int(clock_Hz)

    @command(":STReam:CLEar")
    def _clear_memory(self, _: str) -> None:
        self._catch_up()
        self.blocks.clear()

    @command(":STReam:DATA?")
    def _fetch(self, text: str) -> str:
        self._catch_up()
        content = self.blocks.take(int(self.number(text, 1, _MOST_BYTES)))
        length = str(len(content))
        return f"#{len(length)}{length}" + content.decode("latin-1")  # a reply is text of one byte a character

    @command(":STReam:LOST?")
    def _lost(self, _: str) -> str:
        self._catch_up()
        return str(self.blocks.dropped)


SIMULATOR = PendulumCnt91
