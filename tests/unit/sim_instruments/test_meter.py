"""The simulated 3458A in the current loop, and a calibrator whose gain drifts."""

import numpy as np
import pytest
from sim_bench import Bench, open_bench

from sim_instruments.hp_3458a import ACCURACY, Hp3458A

SEEDS = range(150)
DAY_S = 86_400.0


def configured(bench: Bench, range_A: float) -> Hp3458A:
    bench.send("dmm", "END ALWAYS", f"DCI {range_A:.1E}", "NPLC 100", "AZERO ON", "TRIG HOLD")
    meter = bench.world.instruments["dmm"]
    assert isinstance(meter, Hp3458A)
    assert meter.range == range_A
    return meter


@pytest.mark.parametrize("range_A", [1e-4, 1e-1])
def test_errors_of_a_range_are_as_large_as_its_specification(range_A: float) -> None:
    """Gain and zero of 150 meters: half of the 95 % figures, within 20 % (3.5 standard deviations)."""
    gains, zeros = [], []
    for seed in SEEDS:
        with open_bench(seed=seed) as bench:
            meter = configured(bench, range_A)
            zeros.append(meter.error_A(0.0) / range_A)
            gains.append((meter.error_A(range_A) + meter.error_A(-range_A)) / range_A / 2 - zeros[-1])
            assert abs(gains[-1]) < 1e-12  # gain and linearity are odd in the current
            gains[-1] = (meter.error_A(range_A) - meter.error_A(-range_A)) / range_A / 2
    relative, floor = ACCURACY[range_A]
    assert np.std(zeros) == pytest.approx(floor / 2, rel=0.2)
    assert np.std(gains) == pytest.approx(np.hypot(relative, floor) / 2, rel=0.2)


def test_ranges_have_errors_of_their_own_that_stay() -> None:
    with open_bench(seed=3) as bench:
        first = configured(bench, 1e-3).error_A(1e-3) / 1e-3
        other = configured(bench, 1e-2).error_A(1e-2) / 1e-2
        again = configured(bench, 1e-3).error_A(1e-3) / 1e-3
        assert first == again
        assert first != other


def test_errors_can_be_switched_off() -> None:
    with open_bench(seed=3) as bench:
        bench.world.options["dmm_errors"] = False
        assert configured(bench, 1e-3).error_A(1e-3) == 0.0


def test_gain_of_the_calibrator_drifts_by_the_day() -> None:
    with open_bench(seed=4, options={"calibrator_gain": "off", "calibrator_floor": "off"}) as bench:
        bench.world.options["calibrator_drift_ppm"] = 2.0  # type: ignore[assignment]
        bench.send("calibrator", "OUT 1.0E-01 A, 0 HZ")
        calibrator = bench.world.instruments["calibrator"]
        before_A, before_ns = calibrator.true_current_A(), bench.clock.now_ns()
        bench.clock.sleep(DAY_S)
        after_A, after_ns = calibrator.true_current_A(), bench.clock.now_ns()
        days = (after_ns - before_ns) * 1e-9 / DAY_S
        assert (after_A - before_A) / 0.1 == pytest.approx(2e-6 * days, rel=1e-6)
        assert before_A == pytest.approx(0.1, abs=1e-11)
