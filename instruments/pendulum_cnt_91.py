"""Time tagger of the CNT-91 class: stamps both edges of inputs A and B without a gap and buffers them in blocks.

A real CNT-91 is not enough for a ring laser. It stamps one input at a time, pauses 4 us after each group of four edges
(250,000 stamps/s at best) and knows neither the level of a second comparator nor its own losses; the beat of a dithered
laser has up to 500,000 edges/s. Whatever serves here understands the commands below, those of the handbook and the
``STReam`` ones, which are not of the handbook: a real CNT-91 refuses the first of them with -113, so nothing is
measured by mistake. What it has to offer: 600,000 edges/s, both edges of two inputs in order of time, the level of a
third comparator with each, blocks as in frames/time_tags.yaml, memory for 2 s, a counter of what it had to drop.

    STReam:CLOCk <Hz>       10, 20, 50 or 100 MHz, the unit of all stamps; only while nothing is measured
    STReam:CLEar            empties the memory
    STReam:DATA? <bytes>    the oldest whole blocks, at most so many bytes, as one definite-length block; #10 for none
    STReam:LOST?            edges dropped since INIT

INIT starts the stream and ABOR ends it; what is in the memory then can still be read, and block numbers run on.

Source: CNT-90/91 Programmer's Handbook, May 2017 (INPut:LEVel: -5 to 5 V in steps of 2.5 mV, INPut:COUPling,
INPut:SLOPe, INPut:IMPedance, INPut:ATTenuation, INPut:FILTer, INPut:LEVel:AUTO, INITiate, INITiate:CONTinuous, ABORt,
STATus:OPERation:CONDition? bit 4 = measurement started, *IDN?); 8-72, 8-73 for the limits of its time stamps. Not
confirmed on hardware: everything that is not of the handbook, and its coupling.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from bench.model.clock import to_ns
from bench.model.errors import InstrumentError
from bench.model.ports import Parameter, action
from instruments.commands import Setting, either
from instruments.scpi import ScpiInstrument
from instruments.values import read_integer

CLOCKS_HZ = (10e6, 20e6, 50e6, 100e6)
LONGEST_BLOCK = 24_032  # bytes: 6,000 events
_INPUTS = ("INP", "INP2")  # A: beat, B: dither pick-off
_LEVEL_STEP_V = 0.0025
_MEASURING = 1 << 4
_BATCH = 10 * LONGEST_BLOCK  # bytes asked for at once
_FETCH_LIMIT_S = 0.7  # of each call of the bus; a reading makes two in a row, then begins no other after 0.1 s
_READ_LIMIT_S = 0.1


class PendulumCnt91(ScpiInstrument):
    """Control of the tagger; ``read_stream`` gives what it has buffered to the link of the station that names it.

    Option ``clock_error_ppm``: of a simulated tagger, how much faster than nominal its clock runs.
    """

    identity_pattern = r"PENDULUM.*,CNT-91R?"
    safe_state = "stream ended (ABOR), confirmed by STAT:OPER:COND?; the tagger drives nothing"
    default_options: ClassVar[Mapping[str, Any]] = {"clock_error_ppm": 0.0}
    option_limits = (Parameter("clock_error_ppm", low=-1000.0, high=1000.0),)
    needs = ("END", "device clear")  # a line feed is a byte of a block

    _streams = False  # started and not known to be stopped
    _started = 0  # how often
    _drained = 0  # of which start everything was read; the reader's own, so that no start is overlooked

    @action(
        Parameter("clock", "Hz", 10e6, 100e6, values=CLOCKS_HZ),
        Parameter("threshold", "V", -5.0, 5.0, required=False),
        bus_s=0.6,
    )
    def configure(self, clock: float, threshold: float = 0.0) -> None:
        """Set the clock (10, 20, 50 or 100 MHz) and the trigger level of both inputs (V), dc; a stream ends first.

        Raises: InstrumentError B-INST-008, B-INST-005 (a counter without the stream commands), B-INST-011.
        """
        if clock not in CLOCKS_HZ:
            known = ", ".join(f"{clock_Hz / 1e6:g}" for clock_Hz in CLOCKS_HZ)
            raise self.refusal(f"configure: clock {clock!r} Hz is none of {known} MHz")
        self.stop()
        self.kept = ()
        self.bring("configure")
        levels = (self.put(Setting(f"{name}:LEV?", threshold, _LEVEL_STEP_V, "V")) for name in _INPUTS)
        self.keep(*levels, self.put(Setting("STR:CLOC?", clock, 0.0, "Hz")))

    @action(bus_s=0.3)
    def start(self) -> None:
        """Set the stream going, inputs as they must be; clock and levels must still read back.

        Blocks that an earlier run left are dropped.

        Raises: InstrumentError B-INST-010 before ``configure``, B-INST-005, B-INST-011.
        """
        self.require_kept("start", "clock", "configure it first")
        self.stop()
        self.bring("start")
        self.confirm_kept()
        if self._drained == self._started:
            self.set("STR:CLE")
        self.set("INIT", either(self.measuring, True))
        self._streams = True  # first: a reader in another thread must not take the new start for one that is over
        self._started += 1
        self._confirm_streaming()

    @action(bus_s=0.2)
    def stop(self) -> None:
        """Set the stream to its end; what is buffered can still be read. Raises: InstrumentError B-INST-011."""
        self.set("ABOR", either(self.measuring, False))
        if self.measuring():
            raise self.error("B-INST-011", "it still measures after ABOR", "look at its front panel")
        self._streams = False

    @action(bus_s=0.1)
    def measuring(self) -> bool:
        """Get whether the stream is running."""
        return bool(self.ask("STAT:OPER:COND?", read_integer) & _MEASURING)

    @action(bus_s=0.1, returns="1")
    def events_lost(self) -> int:
        """Get how many edges were dropped since ``start`` because nobody read them in time, or there were too many."""
        return self.ask("STR:LOST?", read_integer)

    def read_stream(self, most_bytes: int) -> bytes:
        """Get what is buffered, whole blocks, at most ``most_bytes``; b"" at once if nothing is there to be read.

        So it is before ``start``, and while somebody, further up in this thread or in another one, talks to the
        instrument. A block that was cut off is handed on as far as it came. Returns after 1.5 s at the latest.
        Raises: InstrumentError B-INST-001, B-INST-003, B-INST-004, unless something was read before.
        """
        blocks: list[bytes] = []
        left, end_ns = most_bytes, self.clock.now_ns() + to_ns(_READ_LIMIT_S)
        while left >= LONGEST_BLOCK:
            started, streams, most = self._started, self._streams, min(left, _BATCH)
            if not streams and self._drained == started:
                break
            try:
                content = self.bus.fetch(f"STR:DATA? {most}", _FETCH_LIMIT_S)
            except InstrumentError:
                if not blocks:
                    raise
                break  # what was read is handed on; the next call tells it if it lasts
            if content is None:
                break
            blocks.append(content)
            left -= len(content)
            if not content and not streams:
                self._drained = started
            if len(content) <= most - LONGEST_BLOCK or self.clock.now_ns() >= end_ns or not self.bus.in_step:
                break
        return b"".join(blocks)

    def _confirm_streaming(self) -> None:
        if not self.measuring():
            raise self.error("B-INST-011", "it does not measure, though the stream was started", "start it again")

    def _recheck(self) -> None:
        super()._recheck()
        if self._streams:
            self._confirm_streaming()

    def _forget(self) -> None:
        super()._forget()
        self._streams, self._drained = False, self._started

    def _safe_command(self) -> str:
        return "ABOR"

    def _go_safe(self) -> None:
        if not self.switch_off("ABOR", lambda: not self.measuring()):
            raise self.error("B-INST-009", "it still measures after ABOR", "stop it at the front panel")
        self._streams = False


DRIVER = PendulumCnt91
