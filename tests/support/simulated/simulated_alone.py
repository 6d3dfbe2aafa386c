"""One simulated instrument alone, on a bus that takes messages and gives replies as text."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import MagicMock

import pyvisa
from pyvisa.errors import VisaIOError

from bench.model.clock import VirtualClock
from sim_instruments.worlds.simulation import open_world

ADDRESS = "GPIB0::8::INSTR"


def complaints(simulator: Any) -> bool:
    """Whether the simulated instrument has refused something since it was last asked; forgets it."""
    if hasattr(simulator, "errors"):
        found = bool(simulator.errors)
        simulator.errors.clear()
        return found
    found = bool(getattr(simulator, "_events", 0) & 0x30)
    simulator.__dict__.update({"_events": 0} if hasattr(simulator, "_events") else {})
    return found


@contextmanager
def simulated(name: str) -> Iterator[Any]:
    """The world of the af-converter with this instrument only, in the state of power-on."""
    entries = {name: {"driver": name, "resource": ADDRESS, "options": {}}}
    world = open_world(
        "af_converter", clock=VirtualClock(), seed=1, station={"instruments": entries, "links": {}},
        unit_factory=lambda *_: MagicMock(),
    )  # fmt: skip
    try:
        yield world
    finally:
        world.close()


class Alone:
    """Messages to the instrument, replies from it, and whether it complained."""

    def __init__(self, simulator: Any, resource: Any) -> None:
        self._simulator = simulator
        self._resource = resource

    def send(self, message: str) -> None:
        self._resource.clear()
        self._resource.write(message)

    def ask(self, message: str) -> str | None:
        self.send(message)
        try:
            return str(self._resource.read()).strip()
        except VisaIOError:
            return None

    def complains(self) -> bool:
        return complaints(self._simulator)


@contextmanager
def alone(name: str) -> Iterator[Alone]:
    with simulated(name) as world:
        resource = pyvisa.ResourceManager(world.visa_library).open_resource(
            ADDRESS, read_termination="\n", write_termination="\n", timeout=3000
        )
        yield Alone(world.instruments[name], resource)
