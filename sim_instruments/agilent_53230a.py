"""Simulated Agilent 53230A counter, input 1 on the function generator's output, external 10 MHz reference connected.

Source: 53220A/53230A Programmer's Reference (FREQuency, SENSe:FREQuency:GATE, ROSCillator, questionable status
bit 10 = reference); User's Guide (131, 133: CONFigure, MEASure and *RST find the threshold by themselves, a threshold
that is given ends that; 140: low-pass at 100 kHz, which CONFigure leaves; 198: scaling); opronningen/53230A-Toolkit,
Learn/Learn.cs (settings after *RST, without the reference). Placeholders: without a signal the measurement ends 1 s
after its gate with 9.91E37; the least signal; the reference value of a scale is always the reading itself.
"""

from __future__ import annotations

from typing import ClassVar

from sim_instruments.agilent_33250a import Agilent33250A
from sim_instruments.bus.scpi import ScpiDevice, command, words
from sim_instruments.faults.fault import Fault, NamedFaults, becomes

NOT_A_NUMBER = 9.91e37
REFERENCE_BIT = 1 << 10
EXTERNAL_SIGMA, INTERNAL_SIGMA = 1e-9, 2e-7  # relative errors of the laboratory's 10 MHz and of the built-in crystal
RESOLUTION_S = 2e-11  # one shot; the resolution of a frequency is this over the gate time
_NO_SIGNAL_S = 1.0
_MOST_READINGS = 1000
_FILTER_HZ = 100e3
_LEAST = 0.004  # RMS value that is counted, part of the input's range


class Agilent53230A(ScpiDevice):
    """Frequency counter; its reading has the error of the reference in use and noise of its resolution."""

    named_faults: ClassVar[NamedFaults] = {
        "reference_lost": Fault(
            "counter", (), "the counters' external 10 MHz is gone",
            becomes(reference_lost=True), becomes(reference_lost=False)),
    }  # fmt: skip
    reference_lost = False
    identity = "Agilent Technologies,53230A,SIM53230,02.05-1519.666-1.19-4.15-127-155-35"
    settings = """
[:SENSe]:FREQuency:GATE:TIME            | gate_s         | 0.1      | 1E-6 1000 s    | +.15E
[:SENSe]:FREQuency:GATE:SOURce          | gate_source    | TIME     | TIME, IMMediate, EXTernal
[:SENSe]:ROSCillator:SOURce             | reference      | -        | INTernal, EXTernal
:SAMPle:COUNt                           | samples        | 1        | 1 1E6          | +.14E
:TRIGger:COUNt                          | triggers       | 1        | 1 1E6          | +.14E
:TRIGger:SOURce                         | trigger_source | IMM      | IMMediate, EXTernal, BUS
:TRIGger:DELay                          | delay_s        | 0.       | 0 3600 s       | +.14E
:INPut1:LEVel:AUTO                      | finds_level    | ON
:INPut1:LEVel[:ABSolute]                | level_V        | 0.       | by _read_level | +.8E
:INPut1:RANGe                           | range_V        | 5.       | 5 50 V         | +.8E
:INPut1:FILTer[:LPASs][:STATe]          | filters        | OFF
:CALCulate1[:STATe]                     | calculates     | OFF
:CALCulate1:SCALe[:STATe]               | scales         | OFF
:CALCulate1:SCALe:FUNCtion              | scale          | NULL     | NULL, PCT, PPM, PPB, SCALe
:CALCulate1:SCALe:GAIN                  | gain           | 1.       | -1E15 1E15     | +.14E
[:SENSe]:FUNCtion[:ON]                  | function       | "FREQ 1" | FREQuency 1, FREQuency 2, FREQuency
[:SENSe]:FREQuency:MODE                 |                | AUTO     | AUTO, RECiprocal, CONTinuous
[:SENSe]:FREQuency:GATE:POLarity        |                | NEG      | NEGative, POSitive
[:SENSe]:ROSCillator:EXTernal:FREQuency |                | 1E7      | 1E6 1E7 Hz
[:SENSe]:ROSCillator:SOURce:AUTO        |                | OFF
:INPut1:IMPedance                       |                | 1E6      | 50 1E6 Ohm
:INPut1:COUPling                        |                | AC       | AC, DC
:INPut1:SLOPe                           |                | POS      | POSitive, NEGative
:INPut1:PROBe                           |                | 1        | 1 10
:INPut1:LEVel:RELative                  |                | 50       | 10 90
:INPut1:NREJect                         |                | OFF
:CALCulate1:SCALe:REFerence:AUTO        |                | ON
:CALCulate1:SMOothing[:STATe]           |                | OFF
:CALCulate1:AVERage[:STATe]             |                | OFF
:OUTPut[:STATe]                         |                | OFF
:FORMat[:DATA]                          |                | ASC,15
:SYSTem:TIMeout                         |                | 9.9E37   | 0.01 2000 s INF
"""

    def power_up(self) -> None:
        self.reference = "INT"
        super().power_up()
        self._external = self.rng("counter external reference").normal(0.0, EXTERNAL_SIGMA)
        self._internal = self.rng("counter internal reference").normal(0.0, INTERNAL_SIGMA)
        self._noise = self.rng("counter noise")

    def reset(self) -> None:
        self._event = 0

    @property
    def _counted_Hz(self) -> float:
        """Frequency that is seen at the input of the function, hertz; 0 for none."""
        source = self.partner(Agilent33250A)
        if source is None or "2" in self.function:
            return 0.0
        peak_V, frequency_Hz = source.open_amplitude_V / 2.0, float(source.true_frequency_Hz)
        reached = peak_V > _LEAST * self.range_V and (self.finds_level or abs(self.level_V) < peak_V)
        return frequency_Hz if reached and not (self.filters and frequency_Hz > _FILTER_HZ) else 0.0

    def _measure(self) -> str:
        frequency_Hz = self._counted_Hz
        self.reply_after(self.delay_s + self.gate_s + (0.0 if frequency_Hz else _NO_SIGNAL_S))
        if frequency_Hz == 0.0:
            return f"{NOT_A_NUMBER:+.15E}"
        self._event |= REFERENCE_BIT if self.reference_lost and self.reference == "EXT" else 0
        error = self._external if self.reference == "EXT" and not self.reference_lost else self._internal
        noise = self._noise.normal(0.0, RESOLUTION_S / self.gate_s)
        return self.reading(f"{self._calculated(frequency_Hz * (1.0 - error + noise)):+.15E}")

    def _calculated(self, value: float) -> float:
        if not (self.calculates and self.scales):
            return value
        return value * self.gain if self.scale == "SCAL" else 0.0  # nothing from itself

    def _read_level(self, text: str) -> float:
        level_V, self.finds_level = self.number(text, -51.0, 51.0, "V"), False
        return level_V

    @command(":CONFigure:FREQuency")
    def _configure(self, text: str) -> None:
        numbers, _, channel = text.partition("(@")
        if expected := words(numbers):
            self.number(expected[0], 1e-3, 4e8, "Hz", DEF=1e7)
        self.function = f"FREQ {self.word(channel or '1)', '1)', '2)')[0]}"
        self.restore("level_V", "finds_level", "gate_s", "gate_source", "samples", "triggers", "trigger_source")

    @command(":STATus:QUEStionable[:EVENt]?")
    def _questionable(self, _: str) -> str:
        if self.reference == "EXT" and self.reference_lost:
            self._event |= REFERENCE_BIT
        return self.read_out("_event")

    @command(":READ?")
    def _read(self, _: str) -> str | None:
        if self.trigger_source != "IMM" or self.gate_source == "EXT":
            return None  # it waits for a trigger that nobody gives
        count = self.samples * self.triggers
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
