"""Choices at the simulated bench of a north finder, and their defaults."""

from __future__ import annotations

from dataclasses import dataclass

PARAMETERS = ("constant", "slow", "step", "linear", "white", "double")

OPTIONS = {
    "noise": "random-walk and vibration noise of the gyroscope, default on",
    "table_rate": "a sensing axis out of the table's plane feels the turning of the table itself, default on",
}
NUMBERS = {
    "scale_V": ("amplitude of the earth signal, default 1", 0.0, 10.0),
    "random_walk_V": ("noise of a sample of 1 ms, standard deviation, default 0.5", 0.0, 10.0),
    "vibration_V": ("noise of a sample of 1 ms from vibration, standard deviation, default 0.5", 0.0, 10.0),
    "wobble_arcmin": ("swing of the turning table at 360 deg/s, amplitude, default 3", 0.0, 60.0),
    "wobble_Hz": ("frequency of that swing, default 60", 0.0, 400.0),
    "axis_tilt_arcmin": ("tilt of the sensing axis up out of the table's plane, default 0", -60.0, 60.0),
    "rotation_tilt_arcmin": ("tilt of the rotation axis about north, right-handed, default 0", -60.0, 60.0),
    "rotation_tilt_east_arcmin": ("tilt of the rotation axis about east, right-handed, default 0", -60.0, 60.0),
    "placement_arcmin": ("misplacement of the index marks, standard deviation of the draw, default 6", 0.0, 600.0),
    "harmonic_2_ppm": ("second harmonic of the earth signal, relative to its amplitude, default 0", -1e5, 1e5),
    "harmonic_3_ppm": ("third harmonic, default 0", -1e5, 1e5),
    "harmonic_4_ppm": ("fourth harmonic, default 0", -1e5, 1e5),
    "harmonic_5_ppm": ("fifth harmonic, default 0", -1e5, 1e5),
    "ramp_s": ("time in which linear parameters rise from -20 to +20 %, then they fall again, default 60", 1.0, 1e5),
}
TEXTS = {"parameters": ("how amplitude and swing vary, within 20 %, default constant", PARAMETERS)}


@dataclass(frozen=True)
class FogOptions:
    """Options of one bench; names and meaning as in ``OPTIONS``, ``NUMBERS`` and ``TEXTS``."""

    noise: bool = True
    table_rate: bool = True
    scale_V: float = 1.0
    random_walk_V: float = 0.5
    vibration_V: float = 0.5
    wobble_arcmin: float = 3.0
    wobble_Hz: float = 60.0
    axis_tilt_arcmin: float = 0.0
    rotation_tilt_arcmin: float = 0.0
    rotation_tilt_east_arcmin: float = 0.0
    placement_arcmin: float = 6.0
    harmonic_2_ppm: float = 0.0
    harmonic_3_ppm: float = 0.0
    harmonic_4_ppm: float = 0.0
    harmonic_5_ppm: float = 0.0
    ramp_s: float = 60.0
    parameters: str = "constant"

    @property
    def harmonics(self) -> dict[int, float]:
        """Relative amplitude by order, only those there are."""
        ppm = {order: getattr(self, f"harmonic_{order}_ppm") for order in range(2, 6)}
        return {order: 1e-6 * size for order, size in ppm.items() if size}
