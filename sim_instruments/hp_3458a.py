"""Simulated HP 3458A digital multimeter, in series with the calibrator's output.

Not SCPI. The END line is off at power-on, so a reply then ends by its line feed only. A reading of 100 power-line
cycles with autozero takes 4 s.

Source: 3458A User's Guide / operating manual (END, ERRSTR?, INBUF, MATH, PRESET, TARM, TRIG, STB?, DCI ranges and
overload). Placeholders: error numbers beyond the order of the error register's bits; only DCV and DCI exist here, and
with DCV nothing is connected to the voltage terminals.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from bench.model.clock import to_ns
from sim_instruments.bus.live import CommandDevice, CommandError

SYNTAX, UNDEFINED, RANGE = 103, 105, 106
ERROR_TEXT = {SYNTAX: "SYNTAX ERROR", UNDEFINED: "UNDEFINED PARAMETER RECEIVED", RANGE: "PARAMETER OUT OF RANGE"}
READY_BIT, ERROR_BIT, READING_BIT = 16, 32, 128
OVERLOAD = 1e38
CURRENT_RANGES_A = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
VOLTAGE_RANGES_V = (0.1, 1.0, 10.0, 100.0, 1000.0)
LINE_HZ = 50.0
_SCALE = 0.5  # of MATH SCALE, as somebody may have left it
INSIDE_DEGC, ACAL_DEGC = 37.2, 36.8
# dc current, 1 year: 95 % of reading and of range; each range has its own shunt, so each draws its own errors
ACCURACY = {
    1e-7: (30e-6, 400e-6), 1e-6: (20e-6, 40e-6), 1e-5: (20e-6, 10e-6), 1e-4: (20e-6, 8e-6),
    1e-3: (20e-6, 5e-6), 1e-2: (20e-6, 5e-6), 1e-1: (35e-6, 5e-6), 1.0: (110e-6, 10e-6),
}  # fmt: skip
LINEARITY_STEPS = 100  # inputs within a hundredth of the range share one linearity error
NOISE_PER_ROOT_CYCLE = 1e-8  # of range, for one power-line cycle


class Hp3458A(CommandDevice):
    """DC current meter; the errors of its ranges are drawn once per run, its noise per reading.

    The world's option ``dmm_errors`` set to off leaves the noise alone.
    """

    identity = "HP3458A"
    overload = " 1.00000000E+38"
    not_a_number = " NAN"  # it has no such reading; what a damaged one would say

    def power_up(self) -> None:
        super().power_up()
        self.errors: deque[int] = deque()
        self._noise = self.world.rng("3458A noise")
        self._power_on()
        self.end_mode = "OFF"

    def _power_on(self) -> None:
        self.function, self.range = "DCV", 10.0
        self.power_line_cycles, self.digits, self.autozero = 10.0, 7, True
        self.arm, self.trig = "AUTO", "AUTO"
        self.buffered, self.scaled = False, False
        self._done_ns = 0

    # --- measuring ---------------------------------------------------------------------------------------------

    @property
    def reading_s(self) -> float:
        """Time of one reading, second."""
        return self.power_line_cycles / LINE_HZ * (2 if self.autozero else 1)

    def _measure(self) -> None:
        if self.function == "DCI":
            true = self.world.wiring.loop_current_A
            limit = self.range * (1.05 if self.range == 1.0 else 1.2)
        else:
            true, limit = 0.0, self.range * 1.2
        noise = self._noise.normal(0.0, NOISE_PER_ROOT_CYCLE / max(self.power_line_cycles, 1e-4) ** 0.5)
        value = (true + self.error_A(true) + self.range * noise) * (_SCALE if self.scaled else 1.0)
        if abs(true) > limit:
            value = OVERLOAD if true > 0 else -OVERLOAD
        self._answer(self.reading(f"{value: .8E}"), after_s=self.reading_s)

    def error_A(self, true_A: float) -> float:
        """Return what the present range adds to a current: its gain, its zero, its linearity; ampere."""
        if self.function != "DCI" or not self.world.options.get("dmm_errors", True):
            return 0.0
        number = CURRENT_RANGES_A.index(self.range)
        relative, floor = (half / 2.0 for half in ACCURACY[self.range])
        gain = self.world.rng("3458A gain", number).normal(0.0, relative)
        zero = self.world.rng("3458A zero", number).normal(0.0, floor)
        step = round(abs(true_A) / self.range * LINEARITY_STEPS)
        linearity = self.world.rng("3458A linearity", number, step).normal(0.0, floor) if step else 0.0
        return float(true_A * gain + self.range * (zero + (linearity if true_A > 0 else -linearity)))

    @property
    def held_until_ns(self) -> int:
        """With the input buffer off a triggering command is done when its reading is."""
        return 0 if self.buffered else self._done_ns

    def _answer(self, text: str, after_s: float = 0.0) -> None:
        self.reply(text + "\r", after_s=after_s, end=self.end_mode != "OFF")

    def next_reply(self) -> Any:
        """With the trigger on AUTO or SYN (power-on, PRESET NORM) being addressed to talk takes a reading."""
        if not self._replies and self.arm == "AUTO" and self.trig in ("AUTO", "SYN"):
            with self.world.lock:
                self._measure()
        return super().next_reply()

    # --- messages ----------------------------------------------------------------------------------------------

    def carry_out(self, command: str) -> None:
        word, _, parameters = command.upper().partition(" ")
        handler = _COMMANDS.get(word)
        if handler is not None:
            handler(self, [part.strip() for part in parameters.split(",")])
        elif word:
            raise CommandError(SYNTAX)

    def error(self, number: int) -> None:
        if number not in self.errors:  # a register: one bit each
            self.errors.append(number)

    def status_byte(self) -> int:
        status = READY_BIT | (ERROR_BIT if self.errors else 0)
        return status | (READING_BIT if self.reply_ready else 0)

    def on_clear(self) -> None:
        self.arm, self.trig = "AUTO", "HOLD"

    def trigger(self) -> None:
        self._measure()

    def _number(self, text: str, low: float, high: float) -> float:
        try:
            value = float(text)
        except ValueError:
            raise CommandError(UNDEFINED) from None
        if not low <= value <= high:
            raise CommandError(RANGE)
        return value

    def _word(self, text: str, *allowed: str) -> str:
        if text not in allowed:
            raise CommandError(UNDEFINED)
        return text

    def _select(self, function: str, words: list[str]) -> None:
        ranges = CURRENT_RANGES_A if function == "DCI" else VOLTAGE_RANGES_V
        if words[0] in ("", "AUTO"):
            self.function, self.range = function, ranges[-1]
            return
        largest = self._number(words[0], 0.0, ranges[-1] * 1.2)
        self.function = function
        self.range = next((r for r in ranges if largest <= r * (1.05 if r == 1.0 else 1.2)), ranges[-1])

    def _end(self, words: list[str]) -> None:
        self.end_mode = self._word(words[0] or "ALWAYS", "OFF", "ON", "ALWAYS")

    def _preset(self, words: list[str]) -> None:
        self._word(words[0] or "NORM", "NORM", "FAST", "DIG")
        self._power_on()
        self.power_line_cycles, self.trig = 1.0, "SYN"

    def _cycles(self, words: list[str]) -> None:
        self.power_line_cycles = self._number(words[0], 0.0, 1000.0)

    def _set_digits(self, words: list[str]) -> None:
        self.digits = int(self._number(words[0], 3, 8))

    def _set_autozero(self, words: list[str]) -> None:
        self.autozero = self._word(words[0] or "ON", "ON", "OFF", "ONCE") == "ON"

    def _set_arm(self, words: list[str]) -> None:
        self.arm = self._word(words[0] or "AUTO", "AUTO", "HOLD", "SGL", "SYN", "EXT")
        if self.arm == "SGL":
            self.arm = "HOLD"
            self._measure()

    def _set_trigger(self, words: list[str]) -> None:
        self.trig = self._word(words[0] or "SGL", "AUTO", "HOLD", "SGL", "SYN", "EXT")
        if self.trig == "SGL":
            self.trig = "HOLD"
            if self.arm == "AUTO":
                self._measure()
                self._done_ns = self.now_ns + to_ns(self.reading_s)

    def _set_buffer(self, words: list[str]) -> None:
        self.buffered = self._word(words[0] or "ON", "OFF", "ON", "0", "1") in ("ON", "1")

    def _set_math(self, words: list[str]) -> None:
        self.scaled = self._word(words[0], "OFF", "SCALE") == "SCALE"

    def _set_range(self, words: list[str]) -> None:
        self._select(self.function, words)

    def _next_error(self, _: list[str]) -> None:
        number = self.errors.popleft() if self.errors else 0
        self._answer(f'{number},"{ERROR_TEXT.get(number, "NO ERROR")}"')

    def _reset(self, _: list[str]) -> None:
        self._power_on()
        self.errors.clear()
        self.end_mode = "OFF"


_COMMANDS: dict[str, Callable[[Hp3458A, list[str]], None]] = {
    "ID?": lambda self, _: self._answer(self.told_identity),
    "RESET": Hp3458A._reset,
    "PRESET": Hp3458A._preset,
    "END": Hp3458A._end,
    "END?": lambda self, _: self._answer(str(("OFF", "ON", "ALWAYS").index(self.end_mode))),
    "DCI": lambda self, words: self._select("DCI", words),
    "DCV": lambda self, words: self._select("DCV", words),
    "RANGE": Hp3458A._set_range,
    "RANGE?": lambda self, _: self._answer(f"{self.range: .8E}"),
    "NPLC": Hp3458A._cycles,
    "NPLC?": lambda self, _: self._answer(f"{self.power_line_cycles: .8E}"),
    "NDIG": Hp3458A._set_digits,
    "AZERO": Hp3458A._set_autozero,
    "TARM": Hp3458A._set_arm,
    "TRIG": Hp3458A._set_trigger,
    "INBUF": Hp3458A._set_buffer,
    "MATH": Hp3458A._set_math,
    "TEMP?": lambda self, _: self._answer(f"{INSIDE_DEGC: .8E}"),
    "CAL?": lambda self, _: self._answer(f"{ACAL_DEGC: .8E}"),  # the only constant that is asked for: 175
    "ERRSTR?": Hp3458A._next_error,
    "STB?": lambda self, _: self._answer(str(self.status_byte())),
}

SIMULATOR = Hp3458A
