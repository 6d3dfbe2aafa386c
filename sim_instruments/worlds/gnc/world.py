"""The world of the GNC bench: test board, modules by serial number, the table they lie on, Earth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from bench.model.clock import Clock
from bench.model.ports import RecordWindow
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.common.motion import AxisMotion
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import Operation, World
from sim_instruments.worlds.gnc.board import PORT, START_V, GncBoard
from sim_instruments.worlds.gnc.imu import GncImu
from sim_instruments.worlds.gnc.imu_errors import ImuOptions
from sim_instruments.worlds.gnc.module import GncModule
from sim_instruments.worlds.gnc.options import parse_faults
from sim_instruments.worlds.gnc.truth import estimates

SITE = Site(latitude_deg=34.2, gravity_m_s2=9.7969, azimuth_deg=90.0)
LONGITUDE_DEG, HEIGHT_M = 108.9, 400.0
FIRST_UNIT = "GNC-01"  # in the socket until somebody puts in another one
MOUNTINGS = ("x", "y", "z")
TABLES = ("turntable", "non_magnetic", "bench")
SWITCHES = 5
_SWITCHES = {text: number for number in range(SWITCHES + 1) for text in (f"{number}", f"{number}.0")}


class GncWorld(World):
    """One simulated GNC bench.

    Args: clock, seed: as of every world.   options: checked ones; switches that are not given are on.
    Attributes: motion: of the table's axes outer, middle, inner.   mounting: body axis along the inner axis.
        table: what the board lies on.   dip_switch: the one that is on, 0 for none.
    Raises: InputError B-SIM-002, a fault that does not exist.
    """

    ports = (PORT,)

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        self._faults_of = parse_faults(str(options.get("faults", "")))
        self._imu_options = ImuOptions(
            errors=bool(options.get("imu_errors", True)),
            noise=bool(options.get("noise", True)),
            tilt_arcmin=float(options.get("tilt_arcmin", 0.0)),
        )
        self.motion = (AxisMotion(), AxisMotion(), AxisMotion())
        self.mounting, self.table, self.dip_switch = "x", "bench", 0
        self._imus: dict[str, GncImu] = {}
        self._modules: dict[str, GncModule] = {}
        self.board = GncBoard(clock, self._module(FIRST_UNIT, seed), lambda: self.dip_switch)
        super().__init__(clock=clock, seed=seed, unit=self.board, thermal=Thermal(), options=options)

    def _insert(self, serial: str) -> None:
        self.board.settle()
        if serial != self.board.module.serial:
            self.board.insert(self._module(serial, self.seed))

    def _set(self, **changed: Any) -> None:
        self.board.settle()
        vars(self).update(changed)

    operations: ClassVar[Mapping[str, Operation]] = {
        "unit": Operation(_insert, lambda value: _serial(str(value)), "a serial number of 1 to 12 characters"),
        "dip_switch": Operation(
            lambda world, number: world._set(dip_switch=number), lambda value: _SWITCHES.get(str(value)),
            f"0 (none) to {SWITCHES}"),
        "mounting": Operation.word(lambda world, axis: world._set(mounting=axis), *MOUNTINGS),
        "table": Operation.word(lambda world, table: world._set(table=table), *TABLES),
    }  # fmt: skip

    @property
    def load(self) -> tuple[float, float]:
        return START_V, self.board.module.power.current_A

    @property
    def rail_V(self) -> float:
        return self.board.board_V

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        first = self.board.module.serial  # what a window without a unit means: the session's only one
        return estimates({first: self._imus[first], **self._imus}, windows)

    def _module(self, serial: str, seed: int) -> GncModule:
        """Return the module of a serial number; one that comes back is the same one."""
        if serial not in self._modules:
            imu = GncImu(seed, serial, self._imu_options, surroundings=self, site=SITE)
            place = (SITE.latitude_deg, LONGITUDE_DEG, HEIGHT_M)
            self._imus[serial] = imu
            self._modules[serial] = GncModule(seed, serial, self._faults_of.get(serial, ()), imu, place)
        return self._modules[serial]


def _serial(text: str) -> str | None:
    return text if 0 < len(text) <= 12 and text.isascii() else None


WORLD = GncWorld
