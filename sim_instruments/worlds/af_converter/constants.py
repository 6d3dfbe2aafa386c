"""Design constants of the simulated unit under test: ten AF converters, two oscillators, two ports.

Source: AF-converter paper, table 1 (ranges) and section 2; the values the paper does not print (reset current, AF
clock, threshold) are chosen so that full scale needs 93 % of the reset current.
"""

from __future__ import annotations

from dataclasses import dataclass

CHANNELS = 10
GYRO_CHANNELS = 6
AF_CLOCK_HZ = 256_000.0
MASTER_HZ = 10_000_000
GATE_S = 0.01
GATE_MASTER_PULSES = round(MASTER_HZ * GATE_S)
INTEGRATED_GATES = 10_000
REFERENCE_DEGC = 20.0
START_V, CURRENT_A = 12.0, 1.25  # of its supply: what it starts at, what it draws


@dataclass(frozen=True)
class ConverterKind:
    """One kind of channel: ``k0_C`` coulomb per pulse, full scale in ampere, bias model about 20 degC.

    ``bias_tc1_A`` to ``bias_tc3_A`` are the sizes of the coefficients of degC, degC2 and degC3; ``hysteresis_A`` is
    the size of the loop (falling minus rising branch) and ``half_width_degC`` the half-width of its play.
    """

    name: str
    k0_C: float
    full_scale_A: float
    bias_A: float
    bias_spread_A: float
    bias_tc1_A: float
    bias_tc2_A: float
    bias_tc3_A: float
    hysteresis_A: float
    half_width_degC: float


GYRO = ConverterKind("gyro", 1.25e-6, 0.299, 400e-9, 25e-9, 2e-9, 4e-12, 8e-14, 20e-9, 2.5)
ACCELEROMETER = ConverterKind("accelerometer", 1.0e-7, 0.0242, -255e-9, 8e-9, 1e-9, 2e-12, 5e-14, 18e-9, 3.0)
KINDS = (GYRO,) * GYRO_CHANNELS + (ACCELEROMETER,) * (CHANNELS - GYRO_CHANNELS)

WHITE_A_RTHZ = 2e-9  # one-sided density of the input noise current
WALK_A_RTH = 0.3e-9  # random walk of the bias
