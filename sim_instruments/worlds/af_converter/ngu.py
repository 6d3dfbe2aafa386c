"""The simulated unit under test: ten charge-balance AF converters, two oscillators, two serial ports.

Sign convention of the whole unit: K_N C_N - K_P C_P = i_in - i_AFbias, so positive input current makes N pulses and
the reading with an open input is -i_AFbias (AF-converter paper, equation (1)).
"""

from __future__ import annotations

from collections.abc import Mapping

from bench.model.arrays import Integers
from bench.model.clock import Clock, VirtualClock
from sim_instruments.worlds.af_converter.core import AHEAD_NS, CommandReader, Request, UnitCore
from sim_instruments.worlds.af_converter.unit_constants import NguTruth
from sim_instruments.worlds.common.port import Port, PortedUnit
from sim_instruments.worlds.common.thermal import TemperatureFunction

ANSWER_NS = 2_000_000  # from a command to its answer
NOMINAL_SUPPLY_V = 28.0


class Ngu(PortedUnit):
    """One simulated unit with the ports "port_a" (measurement) and "port_b" (housekeeping, commands, answers).

    Args:
        clock: clock of the run; with a virtual one the unit works ahead while nothing can change it.
        seed: seed of the unit's truth and of all its noise.
        thermal: unit temperature, degC, at bench times in nanoseconds, (n,) to (n,); a ``UnitTemperature`` also
            tells where it has turned, a plain function has no past and shows no hysteresis.
        options: see NguTruth.
        sensed: temperature at its sensors, where that is another one.   serial: serial number that it answers.
    Raises:
        InputError: B-NGU-001, an option cannot be read.
    """

    def __init__(
        self, clock: Clock, seed: int, thermal: TemperatureFunction, options: Mapping[str, str] | None = None,
        *, sensed: TemperatureFunction | None = None, serial: str = "",
    ) -> None:  # fmt: skip
        self.truth = NguTruth(seed, options)
        super().__init__({"port_a": Port(), "port_b": Port()})
        self._clock = clock
        self._core = UnitCore(self.truth, thermal, self._ports, clock.now_ns(), sensed, serial)
        self._commands = CommandReader(self._core.definition_b)

    # --- the bench ---------------------------------------------------------------------------------------------

    def set_input(self, channel: int, current_A: float, t_ns: int) -> None:
        """Current into a channel (from 1) from ``t_ns`` on, ampere; positive makes N pulses."""
        with self.lock:
            self._core.at(t_ns, lambda t: self._core.set_input(channel, current_A, t))

    def set_open(self, channel: int, t_ns: int) -> None:
        """Nothing is connected to a channel from ``t_ns`` on."""
        self.set_input(channel, 0.0, t_ns)

    def set_fg(self, frequency_Hz: float, t_ns: int) -> None:
        """True frequency at the reference input from ``t_ns`` on, hertz; 0 without a signal."""
        with self.lock:
            self._core.at(t_ns, lambda t: self._core.set_fg(frequency_Hz, t))

    def set_power(self, on: bool, t_ns: int, voltage_V: float = NOMINAL_SUPPLY_V) -> None:
        """Supply on or off from ``t_ns`` on; switched on, the unit boots for a second and then streams 100 Hz."""
        with self.lock:
            self._core.at(t_ns, lambda t: self._core.set_power(voltage_V if on else 0.0, t))

    # --- the ports ---------------------------------------------------------------------------------------------

    def disconnect(self, name: str) -> None:
        """Stop listening to a port."""
        with self.lock:
            self._ports[name].disconnect()

    def _foreseen(self, name: str, t_ns: Integers) -> Integers:
        """As far as the unit has worked ahead."""
        del name
        self._upto_now()
        return t_ns[t_ns <= self._core.generated_ns]

    def write(self, name: str, sent: bytes) -> None:
        """Send bytes to the unit; only port B listens, and it answers each sound command 2 ms later."""
        with self.lock:
            now_ns = self._upto_now()
            for request in self._commands.feed(sent) if name == "port_b" else ():
                self._answer(request, now_ns + ANSWER_NS)

    def _answer(self, request: Request, t_ns: int) -> None:
        self._core.at(t_ns, lambda t: self._core.execute(request, t))

    def _upto_now(self) -> int:
        """Generate what has arrived by now, and ahead while nobody can change anything; returns now."""
        now_ns = self._clock.now_ns()
        core = self._core
        if core.generated_ns < now_ns:
            quiet_ns = self._clock.quiet_until_ns() if isinstance(self._clock, VirtualClock) else now_ns
            core.generate(max(now_ns, min(quiet_ns, core.generated_ns + AHEAD_NS)))
        if core.given_ns < now_ns:
            core.given_ns = now_ns
            for port in self._ports.values():
                if not port.listened:
                    port.discard(now_ns)
        return now_ns
