"""Simulated Example T100 thermometer: 23 degC with a slow wave of 0.5 degC and noise of 0.02 degC.

Source: the page of its driver. Placeholder: it warms nothing up itself.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar

from bench.model.clock import NS
from sim_instruments.bus.scpi import Answers, ScpiDevice, ScpiError, command

MEAN_DEGC, WAVE_DEGC, WAVE_S, NOISE_DEGC = 23.0, 0.5, 600.0, 0.02


class ExampleT100(ScpiDevice):
    """It reads while its excitation is on."""

    identity = "EXAMPLE,T100,SIM100,1.0"
    answers: ClassVar[Answers] = {":OUTPut[:STATe]?": lambda self: "1" if self.on else "0"}

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._noise = self.world.rng("T100 readings")

    def reset(self) -> None:
        self.on = False

    def outputs(self) -> dict[str, Any]:
        return {"on": self.on}

    @command(":OUTPut[:STATe]")
    def _switch(self, text: str) -> None:
        self.on = self.boolean(text)

    @command(":MEASure:TEMPerature?")
    def _measure(self, text: str) -> str:
        if not self.on:
            raise ScpiError(-221, "Settings conflict")
        wave_degC = WAVE_DEGC * math.sin(2.0 * math.pi * self.now_ns / NS / WAVE_S)
        return f"{MEAN_DEGC + wave_degC + NOISE_DEGC * self._noise.standard_normal():+.4f}"


SIMULATOR = ExampleT100
