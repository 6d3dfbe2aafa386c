"""Simulated Agilent 53230A counter, input 1 on the function generator's output, external 10 MHz reference connected.

Source: 53220A/53230A Programmer's Reference (FREQuency, SENSe:FREQuency:GATE, ROSCillator, questionable status
bit 10 = reference). Placeholders: without a signal the measurement ends 1 s after its gate with 9.91E37.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from sim_instruments.agilent_33250a import Agilent33250A
from sim_instruments.bus.kept import HeldSettings, held_count, held_number, held_word
from sim_instruments.bus.scpi import Answers, ScpiDevice, command, words
from sim_instruments.faults.fault import Fault, NamedFaults, becomes

NOT_A_NUMBER = 9.91e37
REFERENCE_BIT = 1 << 10
EXTERNAL_SIGMA, INTERNAL_SIGMA = 1e-9, 2e-7  # relative errors of the laboratory's 10 MHz and of the built-in crystal
RESOLUTION_S = 2e-11  # one shot; the resolution of a frequency is this over the gate time
_NO_SIGNAL_S = 1.0
_MOST_READINGS = 1000


class Agilent53230A(ScpiDevice):
    """Frequency counter; its reading has the error of the reference in use and noise of its resolution."""

    named_faults: ClassVar[NamedFaults] = {
        "reference_lost": Fault(
            "counter", (), "the counters' external 10 MHz is gone",
            becomes(reference_lost=True), becomes(reference_lost=False)),
    }  # fmt: skip
    reference_lost = False
    identity = "Agilent Technologies,53230A,SIM53230,02.05-1519.666-1.19-4.15-127-155-35"
    answers: ClassVar[Answers] = {
        "[:SENSe]:FUNCtion[:ON]?": lambda _: '"FREQ 1"',
        "[:SENSe]:ROSCillator:SOURce?": lambda self: self.reference,
    }
    held: ClassVar[HeldSettings] = {
        "[:SENSe]:FREQuency:GATE:TIME": held_number("gate_s", 1e-6, 1000.0, "s", "+.15E"),
        "[:SENSe]:FREQuency:GATE:SOURce": held_word("gate_source", "TIME", "IMMediate", "EXTernal"),
        ":SAMPle:COUNt": held_count("samples", 1, 1_000_000, "+.14E"),
        ":TRIGger:COUNt": held_count("triggers", 1, 1_000_000, "+.14E"),
        ":TRIGger:SOURce": held_word("trigger_source", "IMMediate", "EXTernal", "BUS"),
        ":INPut1:IMPedance": held_number("impedance_ohm", 50.0, 1e6, "Ohm", "+.14E"),
    }

    def power_up(self) -> None:
        super().power_up()
        self._external = self.rng("counter external reference").normal(0.0, EXTERNAL_SIGMA)
        self._internal = self.rng("counter internal reference").normal(0.0, INTERNAL_SIGMA)
        self._noise = self.rng("counter noise")

    def reset(self) -> None:
        self.gate_s, self.gate_source, self.reference = 0.1, "TIME", "INT"
        self.samples, self.triggers, self.trigger_source, self.impedance_ohm = 1, 1, "IMM", 1e6
        self._event = 0

    def leave_more(self, draw: np.random.Generator) -> None:
        self.gate_s, self.gate_source = 10.0 ** draw.uniform(-3.0, 1.0), str(draw.choice(["TIME", "IMM", "EXT"]))
        self.samples, self.triggers = int(draw.integers(1, 1000)), int(draw.integers(1, 10))
        self.trigger_source = str(draw.choice(["IMM", "EXT", "BUS"]))
        self.impedance_ohm = float(draw.choice([50.0, 1e6]))
        self.reference = str(draw.choice(["INT", "EXT"]))

    def _measure(self) -> str:
        source = self.partner(Agilent33250A)
        frequency_Hz = source.true_frequency_Hz if source is not None else 0.0
        if frequency_Hz == 0.0:
            self.reply_after(self.gate_s + _NO_SIGNAL_S)
            return f"{NOT_A_NUMBER:+.15E}"
        self._event |= REFERENCE_BIT if self.reference_lost and self.reference == "EXT" else 0
        error = self._external if self.reference == "EXT" and not self.reference_lost else self._internal
        noise = self._noise.normal(0.0, RESOLUTION_S / self.gate_s)
        self.reply_after(self.gate_s)
        return self.reading(f"{frequency_Hz * (1.0 - error + noise):+.15E}")

    @command("[:SENSe]:FUNCtion[:ON]")
    def _set_function(self, text: str) -> None:
        self.word(text, "FREQ 1", "FREQ", "FREQUENCY 1", "FREQUENCY")

    @command(":CONFigure:FREQuency")
    def _configure(self, text: str) -> None:
        if words(text):
            self.number(words(text)[0].strip(), 1e-3, 4e8)
        self.gate_s, self.gate_source = 0.1, "TIME"
        self.samples, self.triggers, self.trigger_source = 1, 1, "IMM"

    @command("[:SENSe]:ROSCillator:SOURce")
    def _set_reference(self, text: str) -> None:
        self.reference = self.word(text, "INTernal", "EXTernal")
        if self.reference == "EXT" and self.reference_lost:
            self._event |= REFERENCE_BIT

    @command("[:SENSe]:ROSCillator:EXTernal:FREQuency")
    def _set_external(self, text: str) -> None:
        self.number(text, 1e6, 1e7)

    @command(":STATus:QUEStionable[:EVENt]?")
    def _questionable(self, _: str) -> str:
        if self.reference == "EXT" and self.reference_lost:
            self._event |= REFERENCE_BIT
        value, self._event = self._event, 0
        return str(value)

    @command(":READ?")
    def _read(self, _: str) -> str | None:
        if self.trigger_source != "IMM" or self.gate_source == "EXT":
            return None  # it waits for a trigger that nobody gives
        count = self.samples * self.triggers
        if count == 1:
            return self._measure()
        self.reply_after(count * self.gate_s)
        return ",".join(self._measure() for _ in range(min(count, _MOST_READINGS)))

    @command(":MEASure:FREQuency?")
    def _measure_frequency(self, text: str) -> str:
        self._configure(text)
        return self._measure()

    @command(":ABORt")
    def _abort(self, _: str) -> None:
        self._replies.clear()


SIMULATOR = Agilent53230A
