"""Simulated time tagger of the CNT-91 class, its inputs on the comparators of a ring laser where the bench has one.

Source: CNT-90/91 Programmer's Handbook (INPut, INITiate, ABORt, STATus:OPERation:CONDition?). The STReam commands are
not of the handbook; instruments/pendulum_cnt_91.py says what they mean. Placeholders: memory for 3 s of full blocks,
no limit of edges per second but 6,000 in 10 ms, settings that can be changed only while nothing is measured.
"""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from bench.model.arrays import Integers, Octets
from bench.model.clock import NS
from sim_instruments.bus import kept as of_no_effect
from sim_instruments.bus.scpi import (
    OUT_OF_RANGE,
    SETTINGS_CONFLICT,
    Answers,
    Handler,
    Handlers,
    ScpiDevice,
    ScpiError,
    command,
)
from sim_instruments.bus.time_tag_blocks import TagBlocks

CLOCKS_HZ = (10_000_000, 20_000_000, 50_000_000, 100_000_000)
MEASUREMENT_STARTED = 16  # operation status
INIT_IGNORED = (-213, "Init ignored")
_PS = 10**12
FILTER_PS = 1_600_000  # delay of the low-pass of 100 kHz
_INPUT_WORDS = {
    "COUPling": ("AC", "DC"), "SLOPe": ("POS", "NEG"), "IMPedance": ("1.0E+06", "5.0E+01"), "ATTenuation": ("1", "10"),
    "FILTer": ("0", "1"), "LEVel:AUTO": ("0", "1"),
}  # fmt: skip
_INPUT = {node: words[0] for node, words in _INPUT_WORDS.items()}  # settings of an input after *RST, but for its level
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
        ":INITiate:CONTinuous?": lambda self: str(int(self.continuous)),
        ":STATus:OPERation:CONDition?": lambda self: str(MEASUREMENT_STARTED if self.running else 0),
        ":FORMat:SMAX?": lambda self: "10000",
        ":STReam:CLOCk?": lambda self: str(self.clock_Hz),
        ":INPut1:LEVel?": lambda self: f"{self.level_V[1]:+.8E}",
        ":INPut2:LEVel?": lambda self: f"{self.level_V[2]:+.8E}",
    }

    kept: ClassVar[of_no_effect.KeptSettings] = {
        ":FORMat": of_no_effect.word("ASCii", "REAL", "PACKed"),
        ":ARM:SLOPe": of_no_effect.word("POSitive", "NEGative"),
        ":ARM:SOURce": of_no_effect.word("IMMediate", "EXT1", "EXT2", "EXT4"),
        ":CALibration:INTerpolator:AUTO": of_no_effect.Kept(True),
        "[:SENSe]:ACQuisition:APERture": of_no_effect.Kept(0.01, 20e-9, 1000.0, "S"),
    }

    def power_up(self) -> None:
        self.blocks = TagBlocks()
        self._seen_ns = 0  # until when the inputs were looked at
        super().power_up()
        self._clock_error = float(self.options.get("clock_error_ppm", 0.0)) * 1e-6

    def reset(self) -> None:
        self.level_V = {1: 0.0, 2: 0.0}
        self.inputs = {number: dict(_INPUT) for number in (1, 2)}
        self.clock_Hz, self.continuous, self.running = CLOCKS_HZ[0], False, False
        self.blocks.clear()

    def leave_more(self, draw: np.random.Generator) -> None:
        for number in (1, 2):
            self.level_V[number] = round(draw.uniform(-5.0, 5.0) / _LEVEL_STEP_V) * _LEVEL_STEP_V
            self.inputs[number] = {node: str(draw.choice(words)) for node, words in _INPUT_WORDS.items()}
        self.clock_Hz, self.continuous = int(draw.choice(CLOCKS_HZ)), bool(draw.integers(2))
        if draw.integers(2):
            self._begin()

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

        A level that they do not cross, a divider by ten, a coupling without dc and a load of 50 ohm lose them all; the
        other slope turns the levels over, the filter delays the edges.
        """
        if all(node == {**_INPUT, "COUPling": "DC"} for node in self.inputs.values()):
            return t_ps, channel, levels[0], levels[1]
        kept, late_ps, level = np.ones(t_ps.size, dtype=bool), np.zeros(t_ps.size, np.int64), levels[0].copy()
        for number, node in self.inputs.items():
            mine = channel == number - 1
            crossed = node["IMPedance"] == "1.0E+06" and node["ATTenuation"] == "1" and node["COUPling"] == "DC"
            kept &= ~mine | (crossed and node["LEVel:AUTO"] == "0")
            late_ps[mine] = FILTER_PS * (node["FILTer"] == "1")
            level[mine] ^= np.uint8(node["SLOPe"] == "NEG")
        return (t_ps + late_ps)[kept], channel[kept], level[kept], levels[1][kept]

    @property
    def _source(self) -> EdgeSource | None:
        return self.world if isinstance(self.world, EdgeSource) else None

    def _ticks(self, t_ps: Integers) -> Integers:
        own_ps = t_ps + np.floor(t_ps * self._clock_error).astype(np.int64) if self._clock_error else t_ps
        return own_ps // (_PS // self.clock_Hz)

    def _tick_now(self, t_ns: int) -> int:
        epoch_ns = 0 if self._source is None else self._source.edges_epoch_ns
        return int(self._ticks(np.array([(t_ns - epoch_ns) * (_PS // NS)]))[0])

    def _only_at_rest(self) -> None:
        if self.running:
            raise ScpiError(*SETTINGS_CONFLICT)

    @command(":INITiate[:IMMediate]")
    def _initiate(self, _: str) -> None:
        if self.running:
            raise ScpiError(*INIT_IGNORED)
        self._begin()

    @command(":ABORt")
    def _abort(self, _: str) -> None:
        self._catch_up()
        self.running = False

    @command(":INITiate:CONTinuous")
    def _set_continuous(self, text: str) -> None:
        self._only_at_rest()
        self.continuous = self.boolean(text)

    @command(":STReam:CLOCk")
    def _set_clock(self, text: str) -> None:
        self._only_at_rest()
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

    def further(self) -> Handlers:
        handlers: dict[str, Handler] = {}
        for number in (1, 2):
            handlers[f":INPut{number}:LEVel"] = partial(self._set_level, number)
            for node in _INPUT_WORDS:
                handlers[f":INPut{number}:{node}"] = partial(self._set_input, number, node)
                handlers[f":INPut{number}:{node}?"] = partial(self._input, number, node)
        return handlers

    def _set_input(self, number: int, node: str, text: str) -> None:
        words = _INPUT_WORDS[node]
        if words == ("0", "1"):
            self.inputs[number][node] = str(int(self.boolean(text)))
        elif words[0].isalpha():
            self.inputs[number][node] = self.word(text, *words)
        else:
            value = self.number(text, *sorted(map(float, words)))
            self.inputs[number][node] = min(words, key=lambda word: abs(float(word) - value))

    def _input(self, number: int, node: str, _: str) -> str:
        return self.inputs[number][node]

    def _set_level(self, number: int, text: str) -> None:
        level_V = self.number(text, -5.0, 5.0)
        self.level_V[number] = round(level_V / _LEVEL_STEP_V) * _LEVEL_STEP_V


SIMULATOR = PendulumCnt91
