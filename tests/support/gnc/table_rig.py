"""A simulated bench with a turntable and its driver, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pyvisa
from pyvisa.resources import MessageBasedResource

from bench.model.clock import NS, Clock, VirtualClock
from bench.model.drivers import driver_class
from sim_instruments.worlds.simulation import open_world

ADDRESS = "GPIB0::12::INSTR"


class TableRig:
    """``driver`` and ``table`` (the simulator) of one world; ``resource`` for commands by hand."""

    def __init__(self, world: Any, manager: pyvisa.ResourceManager) -> None:
        self.world, self.clock, self.manager = world, world.clock, manager
        self.table = world.instruments["turntable"]
        self.driver = self.open()
        self.resource: Any = manager.open_resource(ADDRESS, read_termination="\n", write_termination="\n")

    def open(self) -> Any:
        """One more driver, as of another process."""
        resource = self.manager.open_resource(ADDRESS, resource_pyclass=MessageBasedResource)
        return driver_class("acutrol_3000")(
            resource, role="turntable", clock=self.clock, transcript=lambda *_: None, options={}
        )

    def ready(self, rate: float = 300.0, acceleration: float = 300.0) -> Any:
        """The driver with limits set and interlocks closed."""
        for axis in (1, 2, 3):
            self.driver.set_limits(axis, rate, acceleration)
        self.driver.close_interlock()
        return self.driver

    def send(self, *messages: str) -> None:
        """Commands by hand, as far apart as the controller wants them."""
        for message in messages:
            self.clock.sleep(0.2)
            self.resource.write(message)

    def ask(self, message: str) -> str:
        """A question by hand."""
        self.clock.sleep(0.2)
        return str(self.resource.query(message))

    def angles(self) -> list[float]:
        """True angles now, degree."""
        return [float(axis.motion.angle_deg(self.clock.now_ns())) for axis in self.table.axes]

    def rates(self) -> list[float]:
        """True rates now, deg/s."""
        return [float(axis.motion.rate_deg_s(self.clock.now_ns())) for axis in self.table.axes]

    def moved_deg(self, since_ns: int) -> float:
        """The longest way any axis has gone since then, degree."""
        times = np.linspace(since_ns, self.clock.now_ns(), 2000).astype(np.int64)
        return max(float(np.ptp(axis.motion.angle_deg(times))) for axis in self.table.axes)

    def since_s(self, began_ns: int) -> float:
        """Seconds of the bench since then."""
        return float(self.clock.now_ns() - began_ns) / NS


@contextmanager
def open_table(seed: int = 1, clock: Clock | None = None) -> Iterator[TableRig]:
    """A bench with nothing but a turntable."""
    entry = {"driver": "acutrol_3000", "resource": ADDRESS, "options": {}}
    world = open_world(
        "af_converter",
        clock=clock or VirtualClock(),
        seed=seed,
        station={"instruments": {"turntable": entry}, "links": {}},
        unit_factory=lambda *_: MagicMock(),
    )
    manager = pyvisa.ResourceManager(world.visa_library)
    try:
        yield TableRig(world, manager)
    finally:
        manager.close()
        world.close()
