"""Holds what ``bench check`` predicts of a north finder against the spread of analysed campaigns; wrong worlds: no
number that looks sound, and none lost in a right one; the whole bench against its simulated truth.

The campaigns have a physics of their own: one sine per turn, white noise, lock-ins as the weighted mean that their
filters take, a table that swings, a mark that is not quite where it should be. Nothing of them or of the wrong worlds
(``doubt_north``) comes from the product's simulators, and no noise is estimated.
"""

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from math import factorial
from pathlib import Path
from typing import Any

import doubt_north as worlds
import numpy as np
import pytest
from doubt_classes import DOUBTED, REFUSED, WRONG, Switch, classes, is_hidden, right_world, sorted_classes
from fog_material import record_row
from numpy.typing import NDArray
from scipy import signal, stats
from spread_study import key_of as key
from spread_study import outside
from typer.testing import CliRunner

from bench.analysis import PROMPT, Estimates, Material, Planned, Reading
from bench.cli import app
from bench.model.systems import assumptions_of
from bench.plan import compile_sequence
from bench.record import RecordRow
from bench.session.predicted import planned_of, predicted, predicted_lines
from bench.systems.north.analysis import north_estimates
from bench.systems.north.estimators.formulas import lock_in_noise
from bench.systems.north.predicted import predicted as predict
from bench.systems.north.sets import north_sets
from bench.systems.north.solution import Solution, accuracies
from bench.systems.north.solve import site_of, solve

Float = NDArray[np.float64]
LIMIT_DEG = 1.0
EARTH_DEG_H = 15.041067  # 7.292115e-5 rad/s
INDEX_DEG = {"lock_in_1": 270.0, "lock_in_2": 0.0}
PLACEMENT_DEG = 0.1  # of an index mark, standard deviation
_VARIATION, _SLOW_Hz = 0.2, 0.0317  # of an amplitude that varies
_SWINGS, _MEMORY = 7, 16.0  # swings per turn; time constants after which 1e-4 of a step is left


class PlannedNorth:
    """Campaigns of a plan. ``planned``: of a table at one rate, whose lock-ins are configured alike."""

    def __init__(self, planned: Planned) -> None:
        self.planned = planned
        fog, site = planned.campaign["fog"], planned.campaign["site"]
        self.rate_Hz = float(planned.campaign["rate_Hz"])
        self.mark_deg, self.mark_std_deg = float(site["azimuth_deg"]), float(site["azimuth_std_deg"])
        earth_deg_h = EARTH_DEG_H * float(np.cos(np.deg2rad(site["latitude_deg"])))
        self.amplitude_V = fog["output_V_per_deg_h"] * earth_deg_h
        per_sample_deg_h = fog["angle_walk_deg_rth"] * 60.0 * self.rate_Hz**0.5  # deg/rt-h = 60 deg/h/rt-Hz
        self.noise_V = fog["output_V_per_deg_h"] * per_sample_deg_h
        self.swing_deg = fog["table_swing_deg"]
        (settings,) = {tuple(sorted(each.arguments.items())) for each in planned.readings if each.name == "configure"
                       and each.role.startswith("lock_in")}  # fmt: skip
        self.weights = weights(dict(settings), self.rate_Hz)

    def campaigns(self, count: int, seed: int) -> Iterator[tuple[Estimates, dict[str, float], set[str]]]:
        """Yield the estimates of one campaign after the other, what is true of it in degrees, and its false alarms."""
        rng = np.random.default_rng(seed)
        for _ in range(count):
            material, truth = self.campaign(rng)
            solution = solve(north_sets(material), site_of(material.campaign))
            estimates = north_estimates(solution, "least_squares", accuracies(solution, LIMIT_DEG), LIMIT_DEG)
            yield estimates, truth, alarms(solution)

    def campaign(self, rng: np.random.Generator) -> tuple[Material, dict[str, float]]:
        """Return what one campaign records, and what is true: mark, field, placements of the index marks b and a."""
        truth = {"mark": self.mark_deg + rng.normal(0.0, self.mark_std_deg), "field": rng.uniform(0.0, 360.0)}
        truth |= {role: rng.normal(0.0, PLACEMENT_DEG) for role in INDEX_DEG}
        rows: list[RecordRow] = []
        readings: list[Reading] = []
        started: tuple[object, ...] = ()
        for window in self.planned.windows:
            about = window.conditions
            if started != (started := (about["item"], about["place"], about["head_deg"], about.get("parameters"))):
                phase = rng.uniform(0.0, 2.0 * np.pi)  # of the swing at the index: another one after each start
            axis_deg = truth[about["place"]] + about["head_deg"]
            end_s = 1e-9 * window.t_end_ns
            t_s = end_s - (np.arange(self.weights.size)[::-1] + 0.5) / self.rate_Hz
            turned_deg = np.sign(about["rate_deg_s"]) * abs(about["rate_deg_s"]) * t_s
            swing_deg = np.sqrt(2.0) * self.swing_deg * np.sin(np.deg2rad(_SWINGS * turned_deg) + phase)
            theta_deg = turned_deg + swing_deg
            varies = _VARIATION * np.sin(2.0 * np.pi * _SLOW_Hz * t_s) if about.get("parameters") == "TVP" else 0.0
            u_V = self.amplitude_V * (1.0 + varies) * np.cos(np.deg2rad(axis_deg - theta_deg))
            u_V += rng.normal(0.0, self.noise_V, t_s.size)
            recorded = round((window.t_end_ns - window.t_start_ns) * 1e-9 * self.rate_Hz)
            rows.append(
                record_row(end_s - recorded / self.rate_Hz, rows, u_V[-recorded:], theta_deg[-recorded:], dict(about),
                           self.rate_Hz)
            )  # fmt: skip
            late_deg = np.sqrt(2.0) * self.swing_deg * np.sin(phase)
            for role, pulse_deg in INDEX_DEG.items():
                passed_deg = pulse_deg + truth[role] - late_deg  # a table that is ahead passes the mark early
                angle = np.deg2rad(turned_deg - passed_deg - 90.0 * (about["index"] - 1))
                x_V = float(self.weights @ (np.sqrt(2.0) * np.sin(angle) * u_V))
                readings.append(Reading(end_s, len(readings), role, "measure", {"x_V": x_V}, dict(about)))
        return Material(rows, self.planned.campaign, {}, readings=readings), truth


def alarms(solution: Solution) -> set[str]:
    """Return the methods whose noise, white here, is taken for something else."""
    coloured = any(waveform is not None and bool(waveform.widened) for waveform in solution.raw)
    taken = {
        "least_squares": solution.unsteady,
        "likelihood": coloured or bool(np.isfinite(solution.by_method["likelihood"].dof)),
        "quadrant": solution.by_method["quadrant"].calibration == 0.0,
    }
    return {method for method, alarm in taken.items() if alarm}


def weights(settings: dict[str, object], rate_Hz: float) -> Float:
    """Share of each sample in X at the end, (n,), the newest last: the poles' gamma density, behind a mean of 1 s."""
    time_constant_s, poles = float(str(settings["time_constant"])), int(str(settings["slope"])) // 6
    ages = (np.arange(round(_MEMORY * time_constant_s * rate_Hz)) + 0.5) / rate_Hz / time_constant_s
    density = ages ** (poles - 1) * np.exp(-ages) / factorial(poles - 1)
    if settings.get("synchronous") == "on":
        density = np.convolve(density, np.full(round(rate_Hz), 1.0 / round(rate_Hz)))
    return np.asarray(density[::-1] / density.sum())


SHORT = {
    "warm_up": "30 s", "time_constant": "1 s", "settle": "20 s", "record_time": "5 s", "calibration": "1,2,3",
    "heads": "0 deg,50 deg,100 deg,150 deg,200 deg,250 deg,300 deg", "repeats": "1,2", "search": "1,2",
}  # fmt: skip
SETTINGS = {
    "fog_north": SHORT,
    "fog_north_parameters": {name: value for name, value in SHORT.items() if name != "search"} | {"repeats": "1"},
}
RATE_Hz, SEED = 50.0, 5  # frames are thinned out; the declared noise is a density, so that azimuths are as uncertain
WITHOUT_TRUTH = ("azimuth_rms_error",)  # its spread is that about its mean
TIME = "time_to_accuracy"
# What a test sees in white noise: an amplitude that changes; colour of one set or of all; a formula that goes wrong
FALSE_ALARMS = {"least_squares": 0.01, "likelihood": 1.0 - 0.99**2, "quadrant": 0.01}


def thinned(name: str) -> Planned:
    """What an analysis knows of a short form of a sequence, at 50 frames a second."""
    planned = planned_of(compile_sequence(name, None, SETTINGS[name]))
    return replace(planned, campaign={**planned.campaign, "rate_Hz": RATE_Hz})


def true_value(entry: Any, nominal: Any, truth: dict[str, float]) -> float:
    """True value of an estimate of one campaign; of amplitude, noise, bound and time that of the nominal gyroscope."""
    about = entry.conditions
    if entry.quantity == "azimuth":
        return truth[about["place"]] + float(about["head_deg"])
    if entry.quantity == "index_placement":
        return truth["lock_in_1" if about["index"] == "b" else "lock_in_2"]
    return 0.0 if entry.quantity == "azimuth_error" else float(nominal.value)


@cache
def analysed(name: str, count: int, seed: int) -> list[tuple[Any, dict[str, float], set[str]]]:
    """Estimates, truth and false alarms of each campaign."""
    return list(PlannedNorth(thinned(name)).campaigns(count, seed))


def ratios(name: str, count: int, seed: int) -> dict[tuple[str, str], float]:
    """Spread of estimate minus truth over the predicted standard uncertainty, for every estimate that is predicted.

    A time is predicted of campaigns without a false alarm: of these alone.
    """
    nominal = {key(entry): entry for entry in predict(thinned(name)).estimates}
    errors: dict[tuple[str, str], list[float]] = {own: [] for own in nominal}
    for entries, truth, alarms in analysed(name, count, seed):
        for entry in entries:
            if key(entry) in nominal and not (entry.quantity == TIME and entry.conditions["method"] in alarms):
                off = entry.value - true_value(entry, nominal[key(entry)], truth)
                errors[key(entry)].append((off + 180.0) % 360.0 - 180.0 if entry.quantity == "azimuth" else off)
    found = {}
    for own, each in errors.items():
        off = np.array(each) - (np.mean(each) if own[0] in WITHOUT_TRUTH else 0.0)
        found[own] = float(np.sqrt(np.mean(off**2)) / nominal[own].std_uncertainty)
    print(f"{name}, {count} campaigns, seed {seed}, median {np.median(list(found.values())):.3f}")
    print("\n".join(f"{ratio:.3f} {own[0]} {own[1]}" for own, ratio in found.items()))
    return found


@pytest.mark.parametrize(
    ("name", "count", "within"),
    [("fog_north", 30, 0.15), *(pytest.param(name, 500, 0.03, marks=pytest.mark.sweep) for name in SETTINGS)],
)
def test_predicted_is_the_spread_of_campaigns(name: str, count: int, within: float) -> None:
    """Thirty campaigns catch an uncertainty that is wrong by a half."""
    found = ratios(name, count, SEED)
    assert outside(found, count) == {}
    assert np.median(list(found.values())) == pytest.approx(1.0, abs=within)


def test_what_is_stated_is_what_was_predicted() -> None:
    """The error of three calibrations, taken for noise, made azimuths by the lock-ins 3.4 % more uncertain."""
    nominal = {key(entry): entry.std_uncertainty for entry in predict(thinned("fog_north")).estimates}
    stated = [
        entry.std_uncertainty / nominal[key(entry)]
        for entries, *_ in analysed("fog_north", 30, SEED)
        for entry in entries
        if entry.quantity == "azimuth" and entry.conditions["method"] == "least_squares"
    ]
    print(f"stated over predicted {np.sqrt(np.mean(np.square(stated))):.3f}")
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(1.0, abs=0.025)


@pytest.mark.sweep
@pytest.mark.parametrize("method", list(FALSE_ALARMS))
def test_the_time_of_500_campaigns(method: str) -> None:
    """Of all campaigns, those of false alarms among them, 95 % of the intervals hold the true time."""
    (true_s,) = (
        entry.value
        for entry in predict(thinned("fog_north")).estimates
        if entry.quantity == TIME and entry.conditions["method"] == method
    )
    campaigns = analysed("fog_north", 500, SEED)
    times = [
        entry
        for entries, *_ in campaigns
        for entry in entries
        if entry.quantity == TIME and entry.conditions["method"] == method
    ]
    held = sum(abs(entry.value - true_s) <= entry.expanded_uncertainty for entry in times)
    alarms = sum(method in alarmed for *_, alarmed in campaigns)
    print(f"{method}, seed {SEED}: {held} of {len(times)} intervals hold {true_s:.2f} s; {alarms} false alarms")
    for seen, count, share in ((held, len(times), 0.95), (alarms, len(campaigns), FALSE_ALARMS[method])):
        low, high = stats.binom.interval(0.999, count, share)
        assert low <= seen <= high
    assert len(times) >= 0.98 * len(campaigns)  # the others may find that the calibration is too little


def test_it_is_printed_beside_the_bound() -> None:
    output = CliRunner().invoke(app, ["check", "fog_north", "--json"])
    assert output.exit_code == 0, output.output
    document = json.loads(output.stdout)["predicted"]
    ratio = {bound["conditions"]["method"]: bound["ratio"] for bound in document["bounds"]}
    bound_deg = np.rad2deg(np.sqrt(2.0 / 80_000) * 0.5**0.5)  # the paper's noise, 80 s at 1 kHz, amplitude 1 V
    assert document["bounds"][0]["bound"] == pytest.approx(bound_deg, rel=2e-3)
    assert ratio["likelihood"] == pytest.approx(1.0, abs=1e-4)
    assert ratio["least_squares"] == pytest.approx(np.sqrt(80.0 * 5.0 / (32.0 * 3.0) / 4.0), abs=3e-3)  # 32 T/5 each
    assert ratio["quadrant"] > 1.5
    assert ["literal" in sentence for sentence in document["missing"]] == [True]
    assert {entry["quantity"] for entry in document["estimates"]} >= {"azimuth", "azimuth_error", "index_placement"}


@pytest.mark.parametrize(
    ("left_out", "sentence"),
    [("fog", "declare 'fog'"), ("configure", "write 'lock_in_1.configure'")],
)
def test_what_is_not_declared_is_named(left_out: str, sentence: str) -> None:
    planned = thinned("fog_north")
    campaign = {name: value for name, value in planned.campaign.items() if name != left_out}
    readings = [reading for reading in planned.readings if reading.name != left_out]
    found = predict(replace(planned, campaign=campaign, readings=readings))
    assert found.estimates == []
    assert sentence in found.missing[0]


def test_a_table_that_stands_is_named() -> None:
    planned = thinned("fog_north")
    windows = [replace(window, conditions={**window.conditions, "rate_deg_s": 0.0}) for window in planned.windows]
    readings = [replace(reading, conditions={**reading.conditions, "rate_deg_s": 0.0}) for reading in planned.readings]
    found = predict(replace(planned, windows=windows, readings=readings))
    assert found.estimates == []
    assert "which rate" in found.missing[0]


def test_without_a_calibration_the_plan_says_so() -> None:
    planned = thinned("fog_north")
    windows = [window for window in planned.windows if window.conditions["item"] != "calibration"]
    readings = [reading for reading in planned.readings if reading.conditions.get("item") != "calibration"]
    found = predict(replace(planned, windows=windows, readings=readings))
    assert any(sentence.startswith("calibration at a known azimuth: none") for sentence in found.missing)
    assert "index_placement" not in {entry.quantity for entry in found.estimates}


def test_lines_name_the_bound() -> None:
    plan = compile_sequence("fog_north", None, SETTINGS["fog_north"])
    lines = list(predicted_lines(plan, predicted(plan)))
    assert any("of the Cramér-Rao bound" in line for line in lines)
    assert any(reading.name == PROMPT for reading in planned_of(plan).readings)


@pytest.mark.parametrize(("poles", "bandwidth"), [(1, 1 / 4), (2, 1 / 8), (3, 3 / 32), (4, 5 / 64)])
def test_noise_behind_a_lock_in(poles: int, bandwidth: float) -> None:
    """Equivalent noise bandwidths of the SR830's manual, in 1/T; and a filter that is run."""
    due = 0.7 * np.sqrt(2.0 * bandwidth / 3.0 / 1000.0)
    assert lock_in_noise(0.7, 1000.0, 3.0, poles) == pytest.approx(due, rel=1e-4)
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    for _ in range(poles):
        impulse = signal.lfilter([1.0 - np.exp(-0.01)], [1.0, -np.exp(-0.01)], impulse)
    behind_mean = np.convolve(impulse, np.full(100, 0.01))
    found = lock_in_noise(1.0, 100.0, 1.0, poles, mean_s=1.0)
    assert found == pytest.approx(np.sqrt(np.sum(behind_mean**2)), rel=6e-3)


def test_what_an_amplitude_that_varies_changes_is_named() -> None:
    found = predict(thinned("fog_north_parameters"))
    assert any(sentence.startswith("Where parameters vary (TVP)") for sentence in found.missing)
    named = {(entry.quantity, entry.conditions.get("source")) for entry in found.estimates}
    assert named == {("azimuth", None), ("azimuth_error", None), ("index_placement", None), ("scale", "lock_in_1"),
                     ("scale", "lock_in_2")}  # fmt: skip


SEEDS = range(1)  # ten seeds of each, and 500 right worlds: make doubt
NAMED = [
    ("once_per_turn", 0.1, 20, ["once per turn of the bench", "+5.7"]),  # 0.1 of the amplitude: 5.73 deg
    ("modulated", 0.1, 15, ["twice per turn of the bench", "+2.8"]),  # half of it: 2.86 deg
    ("field_motor", 0.1, 5, ["mplitude of the signal, at search only: +0.6", " dB"]),
    ("mark_wrong", 5.0, 20, ["at mark only: +5."]),
    ("bench_turns", 10.0, 20, ["drift from begin to end: +10"]),
    ("bench_knocked", 10.0, 20, ["step between 16.9 min and 18.4 min", "+10"]),
    ("restless", 5.0, 20, ["More than one thing departs"]),
    ("delay_after_move", 10.0, 2, ["zimuth by the lock-ins (delay, index), at search only: -10"]),
    ("noisy_field", 10.0, 2, ["Noise, at search only: +20.7 dB"]),
    ("rate_stated", 2.0, 2, []),
    ("head_scale", 0.03, 10, ["the angle of the dividing head: +10."]),
]
OTHERS = [switch for switch in worlds.SWITCHES if switch.name not in [name for name, *_ in NAMED]]


def switch_of(name: str) -> Switch:
    return next(switch for switch in worlds.SWITCHES if switch.name == name)


@pytest.mark.parametrize("switch", OTHERS, ids=lambda switch: switch.name)
def test_nothing_that_can_be_seen_is_confidently_wrong(switch: Switch) -> None:
    """The gross ones that are not named below; every size is in the long form."""
    size = switch.sizes[-1]
    assert classes(worlds, switch, size, SEEDS)[WRONG] == 0 or (is_hidden(worlds, switch, size) and switch.assumption)


@pytest.mark.parametrize(("name", "size", "doubted", "words"), NAMED)
def test_what_is_wrong_is_named_with_its_size(name: str, size: float, doubted: int, words: list[str]) -> None:
    wrong = worlds.seen(1, switch_of(name), size)
    counted = sorted_classes(wrong, right_world(worlds, 1))
    assert counted[WRONG] == 0
    assert counted[DOUBTED if words else REFUSED] >= doubted
    said = " ".join(reason.sentence for entry in wrong.entries for reason in entry.reasons)
    assert all(word in said for word in words), said


def test_where_one_departure_does_not_explain_the_headings_no_azimuth_is_sure() -> None:
    entries = worlds.seen(0, switch_of("restless"), 0.5).entries
    assert {entry.quality for entry in entries if entry.quantity in ("azimuth", "azimuth_error")} == {"doubtful"}


@pytest.mark.parametrize("seed", range(3))
def test_a_right_world_is_not_doubted(seed: int) -> None:
    assert [entry.reasons for entry in right_world(worlds, seed).entries if entry.quality != "sound"] == []


def test_every_hidden_switch_is_named_by_an_assumption() -> None:
    site = {"latitude_deg": 37.0, "azimuth_deg": 20.0, "azimuth_std_deg": 0.02}
    named = {one.code for one in assumptions_of({"analysis": "fog_north", "site": site})}
    assert {switch.assumption for switch in worlds.SWITCHES} - {""} <= named


FEW = ("warm_up=30 s", "record_time=5 s", "calibration=1", "repeats=1", "search=1", "heads=0 deg,90 deg",
         "time_constant=1 s", "settle=20 s")  # fmt: skip
FOG_SEED = 21


def run(out: Path, *settings: str) -> Path:
    """The folder of a whole campaign; whatever its verdicts are."""
    chosen = dict(one.split("=", 1) for one in (*FEW, *settings))
    sets = [word for name, value in chosen.items() for word in ("--set", f"{name}={value}")]
    words = ["run", "fog_north", "--clock", "virtual", "--seed", str(FOG_SEED), "--truth", "--out", str(out), *sets]
    result = CliRunner().invoke(app, words)
    assert result.exit_code in (0, 1), result.output
    (folder,) = (path for path in out.iterdir() if path.is_dir())
    return folder


def against_truth(folder: Path) -> list[dict[str, Any]]:
    """Azimuths found, each with its ``error``, folded into one turn."""
    truth = json.loads(Path(f"{folder}.truth.json").read_text())["estimates"]
    results = json.loads((folder / "results.json").read_text())
    found = []
    for one in results["estimates"]:
        place = {key: value for key, value in one["conditions"].items() if key != "method"}
        (due,) = (each["value"] for each in truth if (each["quantity"], each["conditions"]) == ("azimuth", place)) \
            if one["quantity"] == "azimuth" else (None,)  # fmt: skip
        if due is not None:
            found.append(one | {"error": (one["value"] - due + 180.0) % 360.0 - 180.0})
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "heads"),
    [
        ("-360 deg/s", "0 deg,90 deg"),
        pytest.param("360 deg/s", "70 deg,160 deg,250 deg,340 deg", marks=pytest.mark.sweep),  # 90, 180, 270, 0 deg
    ],
)
def test_without_noise_the_bench_finds_north_whichever_way_its_table_turns(
    tmp_path: Path, rate: str, heads: str
) -> None:
    """Rotation axis 8 and 5 minutes of arc off, harmonics, misplaced marks; the swing of the table is taken away."""
    tilted = ("world.rotation_tilt_arcmin=8", "world.rotation_tilt_east_arcmin=5", "world.harmonic_3_ppm=10000")
    folder = run(tmp_path, f"rate={rate}", f"heads={heads}", "world.noise=off", "world.wobble_arcmin=0", *tilted)
    errors = {
        (one["conditions"]["method"], one["conditions"]["item"], one["conditions"]["head_deg"]): one["error"]
        for one in against_truth(folder)
        if one["conditions"]["method"] != "literal"
    }
    print(errors)
    assert {key[:2] for key in errors} >= {("least_squares", "test"), ("likelihood", "search"), ("quadrant", "search")}
    assert max(map(abs, errors.values())) < 2e-3


@pytest.mark.slow
def test_with_noise_every_method_is_within_its_uncertainty_and_reads_only_the_records(tmp_path: Path) -> None:
    folder = run(tmp_path)
    found = [one for one in against_truth(folder) if one["conditions"]["method"] != "literal"]
    print([(one["error"], one["std_uncertainty"]) for one in found])
    assert len(found) == 5  # two tests by the method that is judged, one search by three
    assert max(abs(one["error"]) / one["std_uncertainty"] for one in found) < 4.0
    assert max(one["std_uncertainty"] for one in found) < 1.2
    before = json.loads((folder / "results.json").read_text())["estimates"]
    Path(f"{folder}.truth.json").unlink()
    result = CliRunner().invoke(app, ["fit", str(folder), "--json"])
    assert result.exit_code in (0, 1), result.output
    assert json.loads(result.stdout)["estimates"] == before
    replayed = CliRunner().invoke(app, ["replay", str(folder)])
    assert "identical" in replayed.output, replayed.output
