"""The fit against the simulated unit's own converters: truth, 20 seeds, and clock invariance.

The counts come from the exact closed form of the simulated unit, the calibrator from the written constants of
Table 2; nothing of the fit is used to make them. The full sweep of frames, links and instruments is a run of its own.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from ngu_counts import count_windows
from trials import without_budgets

from bench.analysis import Material, analyse
from bench.model.ports import RecordWindow
from bench.model.quality import Quality
from bench.record import RecordRow
from sim_instruments.worlds.af_converter.constants import KINDS
from sim_instruments.worlds.af_converter.unit_constants import NguTruth

FLOOR_A = {2.2e-4: 6e-9, 2.2e-3: 7e-9, 2.2e-2: 40e-9, 2.2e-1: 0.7e-6}
LEVELS_A = {
    "gyro": (30e-6, 100e-6, 1e-3, 10e-3, 100e-3, 200e-3),
    "accelerometer": (0.5e-3, 1e-3, 2e-3, 5e-3, 10e-3, 20e-3),
}
LIMIT_ppm = {"gyro": 8.0, "accelerometer": 5.0}
TEMPERATURES_degC = (-10.0, 5.0, 20.0, 35.0, 50.0)
SLOT_S, POINT_S, SETTLE_S, WINDOW_S = 9000.0, 120.0, 20.0, 100.0


@dataclass(frozen=True)
class Bench:
    """The calibrator of one campaign: common gain, an offset per range and a linearity error per level."""

    gain: float
    offset_A: dict[float, float]
    linearity_A: dict[float, float]

    @classmethod
    def draw(cls, seed: int, gain: bool) -> "Bench":
        rng = np.random.default_rng([seed, 5720])
        offset_A = {full: rng.normal(0, floor / 2) for full, floor in FLOOR_A.items()}
        levels = sorted({level for kind in LEVELS_A.values() for level in kind})
        linearity_A = {level: rng.normal(0, FLOOR_A[holds(level)] / 2) for level in levels}
        return cls(rng.normal(0, 10e-6) if gain else 0.0, offset_A, linearity_A)

    def current_A(self, level_A: float, range_A: float, polarity: int) -> float:
        error_A = self.offset_A[range_A] + self.linearity_A.get(level_A, 0.0)
        return polarity * (level_A * (1 + self.gain) + error_A)


def holds(level_A: float) -> float:
    return next(full for full in FLOOR_A if level_A <= full)


def plan() -> list[dict[str, Any]]:
    """Conditions and times of the 765 records in the order of the 38-hour plan."""
    visits = [(t, channel, 0) for t in TEMPERATURES_degC for channel in range(1, 11)]
    visits.append((TEMPERATURES_degC[-1], 1, 1))
    found: list[dict[str, Any]] = []
    now_s, at = 0.0, None
    for nominal, channel, repeat in visits:
        now_s, at = (now_s + SLOT_S if at != nominal else now_s), nominal
        kind = "gyro" if channel <= 6 else "accelerometer"
        lowest = holds(LEVELS_A[kind][0])
        points = [(0.0, 0, 0.0), (0.0, 1, lowest), (0.0, -1, lowest)]
        points += [(level, sign, holds(level)) for level in LEVELS_A[kind] for sign in (1, -1)]
        for level, polarity, range_A in points:
            conditions = {
                "channel": channel, "kind": kind, "temperature_degC": nominal, "current_A": level,
                "polarity": polarity, "range_A": range_A, "route": "closed" if polarity else "open",
                "repeat": repeat, "purpose": "measurement",
            }  # fmt: skip
            found.append({"start_s": now_s + SETTLE_S, "conditions": conditions})
            now_s += POINT_S
    return found


PLAN = plan()
START_S = np.array([one["start_s"] for one in PLAN])
SLOT_START_S = np.array([next(o["start_s"] for o in PLAN if o["conditions"]["temperature_degC"] == t)
                         for t in (one["conditions"]["temperature_degC"] for one in PLAN)])  # fmt: skip
# the unit lags the chamber by 0.43 degC when a slot of 9,000 s ends, and relaxes with 25 minutes
UNIT_degC = np.array([one["conditions"]["temperature_degC"] for one in PLAN]) - 0.43 * np.exp(
    -(START_S - SLOT_START_S) / 1500.0
)


def rows_of(seed: int, gain: bool, **options: str) -> tuple[list[RecordRow], NguTruth]:
    truth, bench = NguTruth(seed, options), Bench.draw(seed, gain)
    leak_A = np.random.default_rng([seed, 7002]).uniform(-1e-10, 1e-10, (10, 2))
    input_A = np.zeros((len(PLAN), 10))
    for index, one in enumerate(PLAN):
        point = one["conditions"]
        if point["polarity"]:
            current_A = bench.current_A(point["current_A"], point["range_A"], point["polarity"])
            input_A[index, point["channel"] - 1] = current_A + leak_A[point["channel"] - 1, int(point["polarity"] < 0)]
    counts = count_windows(truth, input_A, START_S, UNIT_degC)
    found = []
    for index, one in enumerate(PLAN):
        start_ns = round(one["start_s"] * 1e9)
        window = RecordWindow(index, "port_a", 0, 10_000, start_ns, start_ns + 10**11, one["conditions"])
        context = {"unit_temperature_degC": float(UNIT_degC[index])}
        found.append(RecordRow(window, counts.sums(index), 10_000, 0, 0, Quality.GOOD, context))
    return found, truth


def manifest() -> tuple[dict[str, Any], dict[str, Any]]:
    channels = [
        {
            "number": number, "kind": kind.name, "k0_C": kind.k0_C, "full_scale_A": kind.full_scale_A,
            "sensor_full_scale": 83.0 if kind.name == "gyro" else 20.2,
            "sensor_unit": "deg/s" if kind.name == "gyro" else "g", "levels_A": list(LEVELS_A[kind.name]),
            "stability_limit_ppm": 100.0 if kind.name == "gyro" else 200.0,
            "noise": {"white_A_rtHz": 2e-9, "walk_A_rth": 3e-10},
        }
        for number, kind in enumerate(KINDS, start=1)
    ]  # fmt: skip
    campaign = {
        "analysis": "scale_factor", "reference_temperature_degC": 20.0, "af_clock_Hz": 256e3, "fg_Hz": 1e7,
        "master_Hz": 1e7, "uut": {"model": "NGU", "serial": "SIM-1"}, "channels": channels,
    }  # fmt: skip
    uncertainty = [{"range_A": full, "relative": 20e-6, "floor_A": floor} for full, floor in FLOOR_A.items()]
    return campaign, {"calibrator": {"uncertainty": uncertainty, "corrections": []}}


def errors(estimates: list[dict[str, Any]], truth: NguTruth) -> dict[tuple[str, str], list[float]]:
    """Errors by (kind, quantity): ppm, ppm/degC, ppm/degC2; bias in standard uncertainties."""
    found: dict[tuple[str, str], list[float]] = {}
    for one in estimates:
        conditions, quantity = one["conditions"], one["quantity"]
        channel = conditions.get("channel")
        if quantity in ("dsf_n", "dsf_p", "dsf_asymmetry"):
            at = conditions["unit_temperature_degC"]
            n_ppm, p_ppm = float(truth.dsf_n_ppm(channel, at)), float(truth.dsf_p_ppm(channel, at))
            true = {"dsf_n": n_ppm, "dsf_p": p_ppm, "dsf_asymmetry": n_ppm - p_ppm}[quantity]
            scale = 1.0
        elif quantity in ("dsf_n_tc1", "dsf_n_tc2", "dsf_p_tc1", "dsf_p_tc2"):
            true, scale = truth.tc_ppm(channel, quantity[4])[int(quantity[-1]) - 1], 1.0
        elif quantity == "bias":
            index = next(i for i, row in enumerate(PLAN) if conditions.items() >= {
                key: row["conditions"][key] for key in ("channel", "temperature_degC")}.items())  # fmt: skip
            true = float(truth.bias_A(channel, UNIT_degC[index], START_S[index] + WINDOW_S / 2))
            scale = one["std_uncertainty"]
        else:
            continue
        found.setdefault((conditions["kind"], quantity), []).append((one["value"] - true) / scale)
    return found


@pytest.fixture(autouse=True, scope="module")
def _no_budgets() -> Iterator[None]:
    with without_budgets():
        yield


@pytest.fixture(scope="module")
def gain_off() -> list[tuple[dict[tuple[str, str], list[float]], Any]]:
    """Ten seeds with the gain error off; all twenty are in test_truth_sweep.py."""
    campaign, standards = manifest()
    found = []
    for seed in range(1, 11):
        rows, truth = rows_of(seed, gain=False)
        analysis = analyse(Material(rows, campaign, standards))
        found.append((errors(analysis.estimates, truth), analysis))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["gyro", "accelerometer"])
def test_no_error_beyond_the_limit_with_the_gain_off(gain_off: Any, kind: str) -> None:
    """Seeds 1 to 10: no |DSF error| beyond 8 ppm gyro, 5 ppm accelerometer; asymmetry within 0.25 ppm."""
    worst = {
        quantity: max(float(np.max(np.abs(found[kind, quantity]))) for found, _ in gain_off)
        for quantity in ("dsf_n", "dsf_p", "dsf_asymmetry", "dsf_n_tc1", "dsf_p_tc1", "bias")
    }
    sys.stdout.write(f"{kind}: worst over 10 seeds {worst}\n")
    assert max(worst["dsf_n"], worst["dsf_p"]) < LIMIT_ppm[kind]
    assert worst["dsf_asymmetry"] < 0.25
    assert max(worst["dsf_n_tc1"], worst["dsf_p_tc1"]) < 0.05
    assert worst["bias"] < 5.0


@pytest.mark.slow
def test_residuals_are_as_large_as_declared(gain_off: Any) -> None:
    """Channels of a seed share the errors of the calibrator: ten scatter by 0.1, more are in test_fit_statistics.py."""
    for kind in ("gyro", "accelerometer"):
        chi2 = [one["reduced_chi2"] for _, analysis in gain_off for one in analysis.groups if one["kind"] == kind]
        sys.stdout.write(f"{kind}: mean reduced chi-square {np.mean(chi2):.3f}\n")
        assert 0.8 <= np.mean(chi2) <= 1.2
    assert not [note for _, analysis in gain_off for note in analysis.notes if "B-FIT" in note]


@pytest.mark.slow
def test_no_error_beyond_45_ppm_with_the_gain_of_table_2() -> None:
    """Seeds 1 to 8; all twenty are in test_truth_sweep.py, 500 counted from the physics in test_fit_statistics.py."""
    campaign, standards = manifest()
    worst = 0.0
    for seed in range(1, 9):
        rows, truth = rows_of(seed, gain=True)
        found = errors(analyse(Material(rows, campaign, standards)).estimates, truth)
        values = [found[kind, quantity] for kind in LIMIT_ppm for quantity in ("dsf_n", "dsf_p")]
        worst = max(worst, float(np.max(np.abs(np.concatenate(values)))))
    sys.stdout.write(f"worst over 8 seeds with the gain of Table 2: {worst:.1f} ppm\n")
    assert worst < 45.0


@pytest.mark.slow
@pytest.mark.parametrize("option", ["af_clock_error_ppm", "master_error_ppm"])
def test_clock_error_of_50_ppm_does_not_reach_the_scale_factors(gain_off: Any, option: str) -> None:
    """Mean over 4 seeds, 5 temperatures and the channels of a kind: 160 changes at least, so 0.1 ppm is 3 standard
    deviations of the mean at most; the clocks themselves are 50 ppm off, and as they are otherwise in ``gain_off``.

    Each result also scatters (0.45 ppm gyro, 0.16 ppm accelerometer): other clocks cut the pulses elsewhere, and gated
    counts resolve 12.5 nA and 1 nA.
    """
    campaign, standards = manifest()

    def found(seed: int, error: str) -> dict[tuple[str, str], list[float]]:
        rows, truth = rows_of(seed, gain=False, **{option: error})
        return errors(analyse(Material(rows, campaign, standards)).estimates, truth)

    runs = {error: [found(seed, error) for seed in range(1, 5)] for error in ("-50", "50")}
    runs["as it is"] = [run for run, _ in gain_off[:4]]
    for kind, scatter_ppm in (("gyro", 0.45), ("accelerometer", 0.16)):
        at = {e: np.array([[run[kind, one] for one in ("dsf_n", "dsf_p")] for run in runs[e]]) for e in runs}
        for error in ("-50", "50"):
            change = at[error] - at["as it is"]
            sys.stdout.write(f"{option} {error}: {kind} mean {change.mean():.3f}, sd {change.std():.3f} ppm\n")
            assert abs(change.mean()) < 0.1
            assert change.std() < 1.3 * scatter_ppm


def test_one_seed(gain_off: Any) -> None:
    """Seed 1: both polarities together and all of the estimates."""
    found, _ = gain_off[0]
    for kind, limit_ppm in LIMIT_ppm.items():
        assert len(found[kind, "dsf_n"]) == (30 if kind == "gyro" else 20)
        assert np.max(np.abs(found[kind, "dsf_n"] + found[kind, "dsf_p"])) < limit_ppm
        assert np.max(np.abs(found[kind, "dsf_asymmetry"])) < 0.25
