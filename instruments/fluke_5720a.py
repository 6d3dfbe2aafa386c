"""Fluke 5720A multifunction calibrator, direct current only.

Not SCPI: errors come from ``FAULT?`` (0 = none; the first 15 are kept, the 16th says overflow) and are explained by
``EXPLAIN? n``; they are read out before anything could clear them. Currents are sent in exponent form with ``A``:
``MA`` is milliampere for current but mega for every other unit.

The range the calibrator is really in is not read back: ``OUT?`` does not name it, and how ``RANGE?`` does is not known.
After ``RANGELCK OFF``, acknowledged by an empty fault queue, it is the lowest of ``ranges_A`` that holds the value; the
static check goes by that, and ``OUT?`` confirms the value alone.

With OFFSET, SCALE or BOOST active, keys of the front panel, the terminals carry another current than the set-point and
nothing but bits of ``ISR?`` tells it: wherever that is read they must be 0, and so must those of other functions (state
table). The driver refuses and does not send ``*RST``: no other command that ends them is confirmed, and a reset may
take the entry limits that a person set with it. Guard, sense and range lock are read there, too, as no question for
them is confirmed.

Source: Fluke 5700A/5720A Series II Operators Manual, ch. 5 (5-13 responses, 5-14 input buffer of 128 bytes), command
table 5-2 (5-51: bits of ``ISR?``), 4-46 (SCALE). Not confirmed on hardware: what ``OUT?`` tells with an offset, the
settling limit of 15 s, whether standby shorts or opens the loop, the fault numbers of a compliance trip, the resolution
with which ``OUT?`` answers, minutes of ``ONTIME?`` and days of ``CAL_DAYS? ZERO`` (as in public programs), 30 min of
warm-up and 30 days between zeros.
"""

from __future__ import annotations

from contextlib import suppress

from bench.model.errors import InstrumentError
from bench.model.ports import Effect, Figure, Parameter, Tells, action
from instruments.base import BaseInstrument
from instruments.commands import ReadBack, either
from instruments.values import exponent_form, read_integer, read_number, read_text

_OPERATING = 1 << 0
_SETTLED = 1 << 12
_LOCKED = 1 << 5
_SETTLE_LIMIT_S = 15.0
_POLL_S = 0.25
_INPUT_BUFFER_BYTES = 128
_MINUTE_S = 60.0
_ZERO_LIMIT_DAYS = 30.0
# full scale of each range (A) and its resolution (A)
_RANGES_A = ((2.2e-4, 1e-10), (2.2e-3, 1e-9), (2.2e-2, 1e-8), (2.2e-1, 1e-7), (2.2, 1e-6))


def read_output(reply: str) -> float:
    """Return the current of an ``OUT?`` reply ``value,A,frequency``, ampere. Raises: ValueError unless it is dc."""
    value, unit, frequency = reply.split(",")
    if unit.strip().upper() != "A" or read_number(frequency) != 0:
        raise ValueError("the output is not a dc current")
    return read_number(value)


def _resolution_A(current_A: float) -> float:
    return next(step for full_scale, step in _RANGES_A if current_A <= full_scale)


class Fluke5720A(BaseInstrument):
    """Control of the calibrator's dc current output; polarity belongs to the switch, so currents are never negative."""

    identity_pattern = r"FLUKE,5720A"
    safe_state = "standby (STBY), confirmed by the instrument status register"
    ranges_A = tuple(full_scale for full_scale, _ in _RANGES_A)
    longest_error_queue = 16
    warm_up_s = 30 * _MINUTE_S
    tells = Tells({"ISR?": lambda reply: bool(int(reply) & _OPERATING)}, {"OUT?": Figure("current", "A", read_output)})

    programmed_A: float | None = None

    @action(effect=Effect.STIMULUS_OFF, bus_s=0.5)
    def standby(self) -> None:
        """Set the output to standby and confirm it. Raises: InstrumentError B-INST-009."""
        self._ready()
        self._go_safe()

    @action(
        Parameter("current", "A", 0.0, 2.2),
        Parameter("range", choices=("lowest_that_holds", "locked"), required=False),
        effect=Effect.STIMULUS_SET,
        bus_s=0.5,
    )
    def output(self, current: float, range: str = "lowest_that_holds") -> None:  # noqa: A002 - the sequence's word
        """Set the dc current (ampere) without switching the output on, and read it back.

        ``range`` "locked" keeps the present range (a zero on the range of its point), else the calibrator takes the
        lowest range that holds the value. Raises: InstrumentError B-INST-008, B-INST-005, B-INST-011.
        """
        self.programmed_A = None
        lock = "ON" if range == "locked" else "OFF"
        self.set(f"RANGELCK {lock}", either(lambda: bool(self._status() & _LOCKED), range == "locked"))
        self.set(f"OUT {exponent_form(current)} A, 0 HZ", self._output_read_back(current))
        self._confirm_output(current)
        self.programmed_A = current

    @action(effect=Effect.STIMULUS_ON, bus_s=6.0)
    def operate(self) -> None:
        """Set the output on and return when it is on and settled.

        Refused (B-INST-010) unless ``output`` was set before; the fault queue must be empty, the set-point must read
        back, and what may alter it is set again or refused (B-INST-019). Raises: InstrumentError B-INST-013 if it
        trips, B-INST-012 if it does not settle; standby was sent then.
        """
        if self.programmed_A is None:
            raise self.error("B-INST-010", "operate refused: no output was set by this run", "set the output first")
        self.check_errors("OPER (before)")
        self._confirm_output(self.programmed_A)
        self.bring("operate")  # somebody may have been at its keys since it was prepared
        try:
            on = either(self._is_operating, True)
            self.settle("OPER", on, lambda command: self.bus.write(command, self.timeout_s))
            if not self.poll(self._is_settled, _SETTLE_LIMIT_S, _POLL_S):
                message = f"{self.programmed_A!r} A is not settled {_SETTLE_LIMIT_S:g} s after OPER"
                raise self.error("B-INST-012", message, "look at the load and the calibrator's display")
            self.check_errors("OPER")
        except InstrumentError:
            with suppress(InstrumentError):  # what went wrong first is what counts
                self.bus.write("STBY", self.timeout_s)
            raise

    @action()
    def operating(self) -> bool:
        """Get whether the output is still on; when it is not, the queued faults are read into the transcript.

        Raises: InstrumentError B-INST-019.
        """
        on = bool(self._status() & _OPERATING)
        if not on:
            self.drain_errors()
        return on

    def time_on_s(self) -> float:
        """Get the time since it was switched on, second. Raises: InstrumentError if it does not know the question."""
        self._ready()
        return _MINUTE_S * self.bus.query("ONTIME?", read_number, self.timeout_s, repeatable=False)

    def self_calibration(self) -> tuple[float, float, str, str]:
        """Get how old its dc zeros are: (found, limit, unit, since what). Raises: InstrumentError as ``time_on_s``."""
        self._ready()
        days = self.bus.query("CAL_DAYS? ZERO", read_number, self.timeout_s, repeatable=False)
        return days, _ZERO_LIMIT_DAYS, "days", "since its zeros were calibrated"

    def drain_errors(self) -> list[str]:
        """Get all queued faults with their explanation, oldest first."""
        return [f"{number} {self._explain(number)}" for number in super().drain_errors()]

    def raw(self, command: str, *, answers: bool = False) -> str | None:
        """Control by hand. Raises: InstrumentError B-INST-014 if the command overruns the input buffer."""
        if len(command) >= _INPUT_BUFFER_BYTES:
            message = f"a command of {len(command)} bytes overruns the input buffer of {_INPUT_BUFFER_BYTES} bytes"
            raise self.error("B-INST-014", message, "send it in parts")
        return super().raw(command, answers=answers)

    def _is_settled(self) -> bool:
        status = self._untripped_status()
        return bool(status & _OPERATING and status & _SETTLED)

    def _is_operating(self) -> bool:
        return bool(self._untripped_status() & _OPERATING)

    def _untripped_status(self) -> int:
        """Return instrument status; standby with a fault is a trip. Raises: InstrumentError B-INST-013, B-INST-019."""
        status = self._status()
        if not status & _OPERATING and (faults := self.drain_errors()):
            message = f"tripped to standby at {self.programmed_A!r} A: {'; '.join(faults)}"
            raise self.error("B-INST-013", message, "check that the route is closed and the load holds")
        return status

    def _status(self) -> int:
        """Return instrument status. Raises: InstrumentError B-INST-019 if the current is not that of the set-point."""
        status = self._status_word()
        self.judge("ISR?", str(status))
        return status

    def _status_word(self) -> int:
        return self.ask("ISR?", read_integer)

    def _confirm_output(self, current_A: float) -> None:
        self.agree("OUT?", self.ask("OUT?", read_output), current_A, _resolution_A(current_A), "A")

    def _output_read_back(self, current_A: float) -> ReadBack:
        before_A = self.seen.get("OUT?")
        return ReadBack(
            lambda: self.ask("OUT?", read_output),
            lambda found_A: abs(found_A - current_A) <= _resolution_A(current_A),
            lambda found_A: isinstance(before_A, float) and abs(found_A - before_A) <= _resolution_A(before_A),
        )

    def _recheck(self) -> None:
        if self.programmed_A is not None:
            self._confirm_output(self.programmed_A)

    def _forget(self) -> None:
        self.programmed_A = None

    def _safe_command(self) -> str:
        return "STBY"

    def _explain(self, number: str) -> str:
        return self.bus.query(f"EXPLAIN? {number}", read_text, self.timeout_s).strip('"')

    def _next_error(self) -> str | None:
        number = self.bus.query("FAULT?", read_integer, self.timeout_s, repeatable=False)
        return str(number) if number else None

    def _go_safe(self) -> None:
        if not self.switch_off("STBY", lambda: not self._status_word() & _OPERATING):
            raise self.error("B-INST-009", "still operating after STBY", "press STBY at the front panel")


DRIVER = Fluke5720A
