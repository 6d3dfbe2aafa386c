"""Rates against sums of the counts that were put in: of single frames, of the seconds of a trend, and who has none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench.frame import LinkDecoder, Signal, load_frame, rate_of, signal_of, trailing_means
from bench.model.clock import NS
from bench.model.errors import InputError
from bench.record import LinkReduction, sources_of

ROOT = Path(__file__).resolve().parents[3]
FRAMES = {name: load_frame(ROOT / "frames" / f"{name}.yaml") for name in ("ngu_a", "ngu_a_100s", "imu_200")}
NAMES = ("ngu_a.npp-ppp[3]", "ngu_a.npp-ppp[3]/s", "ngu_a.af_clock/s")


def signals() -> list[Signal]:
    return [signal_of(name, FRAMES) for name in NAMES]


def counted(n: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(11)
    return {name: rng.integers(0, 300, n) for name in ("npp", "ppp", "af_clock")}


def test_the_mean_of_the_last_second_is_the_sum_of_what_came_in_it() -> None:
    counts, t_ns = counted(400), np.arange(400) * (NS // 100)
    pulses = counts["npp"] - counts["ppp"]
    values = np.column_stack((pulses, 100.0 * pulses, 100.0 * counts["af_clock"])).astype(float)
    found = trailing_means(t_ns, signals(), values)
    assert (found[:, 0] == pulses).all()
    assert found[250, 1] == pytest.approx(pulses[151:251].sum())
    assert found[399, 2] == pytest.approx(counts["af_clock"][300:].sum())
    assert np.isnan(found[:50, 1]).all()
    assert np.isfinite(found[50:, 1]).all()


def test_a_second_of_the_trend_has_the_rate_of_its_frames() -> None:
    n, definition = 350, FRAMES["ngu_a"]
    counts = counted(n)
    columns = {
        "counter": np.arange(n), "npp": np.tile(counts["npp"][:, None], (1, 10)),
        "ppp": np.tile(counts["ppp"][:, None], (1, 10)), "af_clock": counts["af_clock"], "master_count": 1,
        "fg_count": 1, "status": 0,
    }  # fmt: skip
    decoder = LinkDecoder(definition)
    for number, row in enumerate(definition.encode(columns, n)):
        decoder.push(round((number + 1) * NS / 100), bytes(row))
    reduction = LinkReduction(sources_of(signals(), FRAMES)[0], definition)
    reduction.push(decoder.flush())
    rows = reduction.rows(0)
    assert rows is not None
    assert rows.start_s.tolist() == [0, 1, 2, 3]
    pulses = counts["npp"] - counts["ppp"]
    for second in range(3):
        of_second = slice(100 * second, 100 * second + 100)
        assert rows.low[second, 0] == pulses[of_second].min()
        assert rows.low[second, 1] == rows.high[second, 1] == pulses[of_second].sum()
        assert rows.low[second, 2] == counts["af_clock"][of_second].sum()
    assert np.isnan(rows.low[3, 1:]).all()  # half of it is not there
    assert np.isfinite(rows.low[3, 0])


def test_only_what_is_counted_per_frame_and_often_has_a_rate() -> None:
    assert rate_of(signal_of("ngu_a_100s.npp[1]", FRAMES), FRAMES) is None
    assert rate_of(signal_of("imu_200.delta_angle[1]", FRAMES), FRAMES) is None
    with pytest.raises(InputError, match="per: frame"):
        signal_of("imu_200.delta_angle[1]/s", FRAMES)
    rate = rate_of(signal_of("ngu_a.npp[1]", FRAMES), FRAMES)
    assert rate is not None
    assert (rate.unit, rate.rate_Hz, rate.decimals) == ("pulse/s", 100.0, 0)
