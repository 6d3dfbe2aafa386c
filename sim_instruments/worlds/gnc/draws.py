"""Draws of one simulated GNC module: a function of the bench's seed, the serial number and the purpose."""

from __future__ import annotations

import zlib

import numpy as np

from sim_instruments.seeds import generator


class ModuleDraws:
    """Generators of one module. What is asked for twice with the same purpose and number is the same twice."""

    def __init__(self, seed: int, serial: str) -> None:
        self._seed, self._serial = seed, zlib.crc32(serial.encode())

    def generator(self, purpose: str, *indexes: int) -> np.random.Generator:
        """Generator of one purpose; ``indexes`` tell several draws of it apart."""
        return generator(self._seed, f"GNC {purpose}", self._serial, *indexes)
