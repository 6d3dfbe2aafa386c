"""North from records and readings made by hand: every method at every azimuth, what excludes a set, what is told;
constant and varying parameters side by side."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fog_material import AZIMUTH_DEG, LATITUDE_DEG, Gyro, NorthRig, campaign, eight_of, rows_of, waveform_of
from one_estimate import every as of
from one_estimate import table_of

from bench.analysis import build_results
from bench.model.clock import NS, VirtualClock
from bench.model.errors import FitError
from bench.systems.north.analysis import METHODS, analyse
from bench.systems.north.report import error_table, parameter_table, result_table
from bench.systems.north.sets import NorthSet, north_sets
from bench.systems.north.solution import Site, Solution, accuracies, rms_std_deg
from bench.systems.north.solve import site_of, solve
from bench.systems.north.wording import method_name
from sim_instruments.worlds.north.world import FogWorld

SEED = 702
CARDINAL = tuple((azimuth - AZIMUTH_DEG) % 360.0 for azimuth in (0.0, 90.0, 180.0, 270.0))
NOISY = Gyro(noise_V=np.sqrt(0.5))
PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "x 1"}


def solved(rig: NorthRig, **more):
    material = rig.material(**more)
    return solve(north_sets(material), site_of(material.campaign))


@pytest.mark.parametrize("rate_deg_s", [360.0, -360.0])
def test_without_noise_every_azimuth_is_found_whichever_way_the_table_turns(rate_deg_s: float) -> None:
    """Rotation matrices in the rig, formulas in the product; pulses, lock-ins, level and waveform all off."""
    gyro = Gyro(
        placement_deg=(0.4, -0.7), gains=(1.02, 0.97), lock_in_offset_V=(0.01, -0.02), tilt_mrad=(0.5, -0.3),
        harmonics={2: 0.02, 3: 0.01},
    )  # fmt: skip
    rig = campaign(NorthRig(SEED, gyro), (*CARDINAL, 33.0, 251.0), 1, rate_deg_s, field_deg=213.4)
    found = solved(rig)
    for method in ("least_squares", "likelihood", "quadrant"):
        errors_deg = found.error_deg(method)
        assert np.isfinite(errors_deg).sum() == 6
        assert np.nanmax(np.abs(errors_deg)) < 1e-3
        (search,) = (one for one in found.means(method) if one.item == "search")
        assert search.azimuth_deg % 360.0 == pytest.approx(213.4, abs=1e-3)
    placement = {one.conditions["index"]: one.value for one in of(analyse(rig.material()), "index_placement")}
    assert placement == {"a": pytest.approx(0.4, abs=1e-3), "b": pytest.approx(-0.7, abs=1e-3)}


def test_the_level_is_what_takes_the_tilt_out() -> None:
    rig = campaign(NorthRig(SEED, Gyro(tilt_mrad=(2.0, -1.0))), (0.0, 90.0), 1)
    rig.readings = [one for one in rig.readings if one.role != "level"]
    found = solved(rig)
    tilted_deg = np.rad2deg(2e-3) * np.tan(np.deg2rad(LATITUDE_DEG))
    errors_deg = found.error_deg("likelihood")[found.of("test")]
    assert 0.3 * tilted_deg < np.abs(errors_deg).max() < 1.2 * tilted_deg
    assert any("not measured" in note for note in analyse(rig.material()).notes)


def test_the_literal_formulas_are_half_a_turn_off_on_half_of_the_circle() -> None:
    heads = tuple(float(head) for head in range(5, 365, 30))
    analysis = analyse(campaign(NorthRig(SEED), heads, 1).material())
    (literal,) = (row for row in table_of(analysis, "Methods").rows if row[0] == "literal")
    assert literal[6] == 6
    assert abs(float(literal[3].replace("−", "-"))) < 0.1
    assert not of(analysis, "azimuth", method="literal")
    assert of(analysis, "azimuth_rms_error", method="literal")[0].value == pytest.approx(180.0 / np.sqrt(2), abs=0.1)
    (failed,) = (row for row in table_of(analysis, "Failures of the literal formulas").rows if "half a turn" in row[0])
    assert failed[1] >= 6
    assert any("literal: 6 of 12 tests are more than 90 deg off" in note for note in analysis.notes)
    (figure,) = (one for one in analysis.figures if one.title == "Error of the literal formulas")
    assert max(map(abs, figure.series[0].y)) == pytest.approx(180.0, abs=0.1)  # folded into one turn, not half


def test_results_with_noise_have_the_form_of_the_contract() -> None:
    noisy = analyse(campaign(NorthRig(SEED, NOISY), repeats=3).material())
    build_results("one", noisy, {}, PROVENANCE)
    assert noisy.missing == []
    errors = of(noisy, "azimuth_error")
    assert len(errors) == 5
    assert {one.limit for one in errors} == {0.5}
    assert max(abs(one.value) / one.std_uncertainty for one in errors) < 3.5
    assert 0.2 < errors[0].std_uncertainty < 0.5
    found_by = {one.conditions["method"] for one in of(noisy, "azimuth", item="search")}
    assert found_by == set(METHODS) - {"literal"}  # its interval is every direction
    assert of(noisy, "scale", source="waveform")[0].value == pytest.approx(1.0, abs=0.01)
    assert of(noisy, "scale", source="lock_in_1")[0].value == pytest.approx(1.0, abs=0.03)
    assert of(noisy, "noise")[0].value == pytest.approx(np.sqrt(0.5), rel=0.01)
    bound_deg = np.rad2deg(np.sqrt(2.0 * 0.5 / 20_000))  # design figure 0.405 deg: 20 s at 1 kHz
    assert of(noisy, "azimuth_bound")[0].value == pytest.approx(bound_deg, rel=0.01)


def test_the_method_chosen_is_the_one_that_is_judged() -> None:
    rig = campaign(NorthRig(SEED, NOISY), (0.0, 90.0), 1)
    for method in METHODS:
        errors = of(analyse(rig.material(), method), "azimuth_error")
        assert {one.conditions["method"] for one in errors} == {method}
        assert all(one.verdict != "none" for one in errors)
    wide = analyse(rig.material(limits={"azimuth_error": {"value": 240.0, "unit": "arcmin"}}), "likelihood")
    assert {one.limit for one in of(wide, "azimuth_error")} == {4.0}
    assert {one.verdict for one in of(wide, "azimuth_error")} == {"pass"}


def test_an_azimuth_that_is_stated_wrong_fails() -> None:
    rig = NorthRig(SEED, Gyro(noise_V=0.05))
    rig.set("calibration", AZIMUTH_DEG)
    for repeat in (1, 2):
        rig.set("test", AZIMUTH_DEG + 91.0, head_deg=90.0, repeat=repeat)  # the head stands a degree off
    assert [one.verdict for one in of(analyse(rig.material()), "azimuth_error")] == ["fail"]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"overload": True}, "lock_in_1 at index position 1: overload"),
        ({"unlocked": True}, "lock_in_1 at index position 1: unlocked"),
        ({"x_V": float("nan")}, "lock_in_1 at index position 1: no number"),
        ({"frequency_Hz": 1.01}, "reference at 1.0100 Hz, the table turns at 1.0000 Hz"),
    ],
)
def test_a_flag_excludes_its_set_and_is_told(wrong: dict[str, object], said: str) -> None:
    rig = campaign(NorthRig(SEED, Gyro(noise_V=0.05)), (0.0, 90.0), 1)
    rig.set("test", AZIMUTH_DEG + 45.0, head_deg=45.0, repeat=1, **({"x_V": 9.9} | wrong))
    analysis = analyse(rig.material())
    (sentence,) = analysis.missing
    assert said in sentence
    assert sentence.startswith("test at head 45 deg, repeat 1")
    assert [one.conditions["head_deg"] for one in of(analysis, "azimuth_error")] == [0.0, 90.0]
    assert any(said in note for note in analysis.notes)
    assert len(of(analyse(rig.material(), "likelihood"), "azimuth_error")) == 3  # the waveform is sound


def a_reading_is_gone(rig: NorthRig) -> None:
    gone = next(
        one for one in rig.readings
        if one.role == "lock_in_2" and one.conditions["item"] == "test" and one.conditions["index"] == 3
    )  # fmt: skip
    rig.readings.remove(gone)


def samples_are_lost(rig: NorthRig) -> None:
    rig.rows[5] = replace(rig.rows[5], lost=3)


def the_table_stops(rig: NorthRig) -> None:
    rig.rows[6].samples.columns["encoder"][:] = 77


def the_table_stands(rig: NorthRig) -> None:
    for row in rig.rows[4:8]:
        row.samples.columns["encoder"][:] = 77


@pytest.mark.parametrize(
    ("spoil", "told", "by_samples", "by_waveform"),
    [
        (a_reading_is_gone, "test at head 0 deg, repeat 1: no reading of lock_in_2 at index position 3", 1, 2),
        (samples_are_lost, "test at head 0 deg, repeat 1, raw waveform: 3 samples lost at index position 2", 2, 1),
        (the_table_stops, "test at head 0 deg, repeat 1, raw waveform: the table stopped at index position 3", 2, 1),
        (the_table_stands, "B-FIT-112", 2, 1),
    ],
)
def test_what_is_spoiled_costs_its_lock_ins_or_its_waveform(
    spoil: Callable[[NorthRig], None], told: str, by_samples: int, by_waveform: int
) -> None:
    rig = campaign(NorthRig(SEED), (0.0, 90.0), 1)
    spoil(rig)
    analysis = analyse(rig.material())
    (sentence,) = analysis.missing
    assert told in sentence
    assert len(of(analysis, "azimuth_error")) == by_samples
    assert len(of(analyse(rig.material(), "likelihood"), "azimuth_error")) == by_waveform


def test_a_gyroscope_that_was_off_costs_the_eight_samples_too() -> None:
    """A lock-in averages over the dark time without a word; only the samples that are missing tell it."""
    rig = campaign(NorthRig(SEED), (0.0, 90.0), 1)
    row = rig.rows[5]
    seconds = 1e-9 * (row.window.t_end_ns - row.window.t_start_ns)
    rig.rows[5] = replace(row, lost=row.frames)  # every other one: half of the time
    analysis = analyse(rig.material())
    (told,) = [one for one in analysis.missing if "waveform" not in one]
    assert f"{seconds / 2:.2f} s of samples lost at index position 2" in told
    assert len(of(analysis, "azimuth_error")) == 1


def test_a_reading_taken_again_counts_last_and_one_without_conditions_belongs_to_the_record_before_it() -> None:
    rig = campaign(NorthRig(SEED), (0.0,), 1)
    first = next(one for one in rig.readings if one.role == "lock_in_1" and one.conditions["item"] == "test")
    rig.readings.insert(0, replace(first, t_s=first.t_s - 0.001, value=first.value | {"x_V": 55.0}))
    assert np.nanmax(np.abs(solved(rig).error_deg("least_squares"))) < 1e-3
    bare = campaign(NorthRig(SEED), (0.0,), 1)
    bare.readings = [
        one if one.role == "level" else replace(one, conditions={}, t_s=one.t_s - 0.005) for one in bare.readings
    ]
    assert np.nanmax(np.abs(solved(bare).error_deg("least_squares"))) < 1e-3


@pytest.mark.parametrize("calibrated", [False, True])
def test_pulses_are_taken_to_stand_where_they_should_without_a_calibration_of_the_sense(calibrated: bool) -> None:
    rig = NorthRig(SEED, Gyro(placement_deg=(0.5, 0.5)))
    if calibrated:
        rig.set("calibration", AZIMUTH_DEG, rate_deg_s=360.0)
    rig.set("test", AZIMUTH_DEG, rate_deg_s=-360.0 if calibrated else 360.0)
    analysis = analyse(rig.material())
    assert of(analysis, "azimuth_error")[0].value == pytest.approx(-0.5, abs=1e-3)
    if calibrated:
        assert any("No calibration for a table that turns clockwise" in note for note in analysis.notes)
    else:
        assert any(one.startswith("calibration at a known azimuth: none") for one in analysis.missing)
        assert of(analysis, "index_placement") == []


def test_a_swinging_table_is_seen_by_the_encoder_and_counted() -> None:
    """0.05 degrees at 60 times the turn: 0.035 RMS, at the index of the calibration and at that of the test."""
    found = solved(campaign(NorthRig(SEED, Gyro(swing_deg=0.05)), (0.0,), 1))
    assert found.swing_deg == pytest.approx(0.05 / np.sqrt(2), rel=0.01)
    by_method = {method: found.means(method)[0].std_deg for method in METHODS}
    assert by_method["least_squares"] == pytest.approx(0.05, rel=0.05)
    assert by_method["likelihood"] < 1e-3


def test_what_the_site_states_is_in_the_uncertainty() -> None:
    """The azimuth of the mark calibrates the pulses; likelihood knows it only as what its error is taken against."""
    site = {"latitude_deg": 45.0, "azimuth_deg": AZIMUTH_DEG, "azimuth_std_deg": 0.3, "tilt_std_deg": 0.04}
    found = solved(campaign(NorthRig(SEED), (0.0,), 1), site=site)
    stds = {method: (found.means(method)[0].std_deg, found.means(method)[0].error_std_deg) for method in METHODS[:2]}
    both = np.hypot(0.3, 0.04)
    assert stds["least_squares"] == (pytest.approx(both, rel=1e-3), pytest.approx(0.04, rel=1e-2))
    assert stds["likelihood"] == (pytest.approx(0.04, rel=1e-2), pytest.approx(both, rel=1e-3))


def test_pulses_apart_are_no_noise_of_the_paper_s_formulas() -> None:
    """Index B 2 degrees off: what the calibration knows of is not found again in the uncertainty of another method."""
    found = solved(campaign(NorthRig(SEED, Gyro(placement_deg=(0.0, 2.0), noise_V=0.01)), (0.0, 90.0), 1))
    stds_deg = [found.by_method[method].noise_deg for method in ("least_squares", "quadrant")]
    assert 1.0 < stds_deg[1] / stds_deg[0] < 3.0


def test_placement_knows_the_swing_and_the_mark_and_the_bound_its_amplitude() -> None:
    site = {"latitude_deg": 45.0, "azimuth_deg": AZIMUTH_DEG, "azimuth_std_deg": 0.3, "tilt_std_deg": 0.04}
    analysis = analyse(campaign(NorthRig(SEED, Gyro(swing_deg=0.05, noise_V=0.01)), (0.0,), 1).material(site=site))
    due_deg = np.sqrt(0.3**2 + 0.04**2 + 0.05**2 / 2.0)
    placements = of(analysis, "index_placement")
    assert [one.std_uncertainty for one in placements] == pytest.approx([due_deg] * 2, rel=0.01)
    (bound,) = of(analyse(campaign(NorthRig(SEED, NOISY), (0.0,), 1).material()), "azimuth_bound")
    # Monte Carlo: relative scatter of noise / amplitude, each of 20,000 samples at noise = amplitude / sqrt 2
    rng = np.random.default_rng(SEED)
    sizes = rng.normal(1.0, np.sqrt(1.0 / 20_000), 4000)
    noises = np.sqrt(rng.chisquare(20_000, 4000) / 20_000)
    due = float(np.std(noises / sizes)) / np.sqrt(bound.n / 20_000)
    assert bound.std_uncertainty / bound.value == pytest.approx(due, rel=0.05)


def test_the_rms_error_shares_the_error_of_the_calibration() -> None:
    """40 tests behind one calibration of half their noise: how far their RMS scatters, drawn."""
    rng = np.random.default_rng(SEED)
    errors_deg = rng.normal(0.0, 0.5, (5000, 1)) + rng.normal(0.0, 1.0, (5000, 40))
    rms_deg = np.sqrt(np.mean(errors_deg**2, axis=1))
    assert rms_std_deg(np.sqrt(1.25), 1.0, 0.5, 40) == pytest.approx(np.std(rms_deg), rel=0.1)
    assert rms_std_deg(1e-6, 1e-7, 0.02, 5) < 1e-6  # a mark that is better than it says
    accuracy = accuracies(solved(campaign(NorthRig(SEED, NOISY), (0.0, 90.0), 1)), 0.5)
    assert accuracy[0].rms_std_deg > 1.2 * accuracy[0].rms_deg / np.sqrt(2.0 * accuracy[0].used)


@pytest.mark.parametrize(
    ("doubt", "said"),
    [
        ("weak", "hardly stronger than its noise"),
        ("level", "3 of 4 sets have no reading of the level"),
        ("rate", "The table turned at 180, 360 deg/s"),
        ("head", "at calibration only"),
    ],
)
def test_what_no_uncertainty_can_know_is_said(doubt: str, said: str) -> None:
    rig = NorthRig(SEED, Gyro(noise_V=15.0 if doubt == "weak" else 0.01))
    if doubt == "level":
        rig.level(item="calibration", head_deg=0.0)
    rig.set("calibration", AZIMUTH_DEG + (90.0 if doubt == "head" else 0.0))
    for head_deg in (0.0, 90.0):
        rig.set("test", AZIMUTH_DEG + head_deg, head_deg=head_deg, rate_deg_s=180.0 if doubt == "rate" else 360.0)
    rig.set("search", 213.4, place="field")
    analysis = analyse(rig.material())
    assert any(said in note for note in [*analysis.notes, *(seen.sentence for seen in analysis.evidence)])
    quiet = analyse(campaign(NorthRig(SEED, NOISY), (0.0, 90.0), 1).material())
    assert not any(said[-20:] in note for note in quiet.notes)


def test_pulses_exchanged_cost_the_eight_samples_and_not_the_waveform() -> None:
    rig = campaign(NorthRig(SEED, Gyro(placement_deg=(0.0, 180.0), noise_V=0.01)), (0.0,), 1)
    analysis = analyse(rig.material(), "likelihood")
    assert of(analysis, "azimuth_error")[0].value == pytest.approx(0.0, abs=0.05)
    assert "B-FIT-111" in analysis.missing[0]
    assert of(analysis, "azimuth", method="least_squares") == []
    with pytest.raises(FitError, match=r"B-FOG-005: .*B-FIT-111"):
        analyse(rig.material())


def test_an_amplitude_that_drifts_moves_north_little_and_is_told() -> None:
    """From -20 to +20 % over a campaign, one record after the other."""
    steady, rig = (campaign(NorthRig(SEED, Gyro(noise_V=0.02)), (0.0, 90.0, 200.0), 1) for _ in range(2))
    shares = np.linspace(0.8, 1.2, len(rig.rows))
    for row, share in zip(rig.rows, shares, strict=True):
        row.samples.columns["output"] = np.rint(row.samples.columns["output"] * share).astype(np.int32)
    lock_ins = [k for k, one in enumerate(rig.readings) if one.role != "level"]
    for place, k in enumerate(lock_ins):
        one = rig.readings[k]
        rig.readings[k] = replace(one, value=one.value | {"x_V": one.value["x_V"] * shares[place // 2]})
    analysis = analyse(rig.material())
    assert max(abs(one.value) for one in of(analysis, "azimuth_error")) < 0.2
    assert any("The amplitude changes between index positions" in note for note in analysis.notes)
    (scale,) = of(analysis, "scale", source="waveform")
    assert abs(scale.value - 1.0) < scale.expanded_uncertainty
    assert scale.std_uncertainty > 0.03
    assert not any("The amplitude changes" in note for note in analyse(steady.material()).notes)


def test_harmonics_are_named_with_what_a_square_reference_makes_of_them() -> None:
    rows = table_of(analyse(campaign(NorthRig(SEED, Gyro(harmonics={3: 0.01})), (0.0,), 1).material()),
                 "Harmonics of the waveform").rows  # fmt: skip
    assert rows[1] == [3, "1.000", "0.191"]  # design figure: 1 % of the third harmonic


HEADS_deg = tuple(float(head) for head in range(10, 370, 45))
KINDS = {"TIP": "constant", "TVP": "slow"}
MARK_deg = 20.0


def a_set(item: str, head_deg: float, repeat: int, kind: str, rng: np.random.Generator, t_s: float) -> NorthSet:
    u_V, theta_deg = waveform_of(KINDS.get(kind, "constant"), MARK_deg + head_deg, 0.0, rng)
    own = NorthSet(item, "mark", head_deg, repeat, 360.0, *eight_of(u_V), parameters=kind, begin_s=t_s, end_s=t_s)
    own.rows = rows_of(u_V, theta_deg)
    return own


@pytest.fixture(scope="module")
def both() -> Solution:
    """Without noise: two sets of calibration, then every heading with constant and with varying parameters."""
    rng = np.random.default_rng(17)
    sets = [a_set("calibration", 0.0, repeat, "", rng, repeat) for repeat in (1, 2)]
    for kind in KINDS:
        sets += [a_set("test", head_deg, 1, kind, rng, 10.0 + len(sets)) for head_deg in HEADS_deg]
    return solve(sets, Site(37.0, MARK_deg))


def test_each_kind_has_its_own_errors_and_no_mean_of_both(both: Solution) -> None:
    """Without noise constant parameters leave nothing; varying ones turn the paper's formulas by degrees, and least
    squares by a sixth of one (prototypes of the design: 3.6 and 0.16 deg RMS)."""
    (table,) = parameter_table(both)
    names = {method_name(method): method for method in (*METHODS, "literal")}
    rows = {names[row[0]]: dict(zip(table.headers, row, strict=True)) for row in table.rows}
    constant, varying = ({name: float(row[f"{kind}: RMS, deg"]) for name, row in rows.items()} for kind in KINDS)
    assert constant["least_squares"] == constant["likelihood"] == constant["quadrant"] == 0.0
    assert varying["quadrant"] > 1.0
    assert 0.0 < varying["likelihood"] < 0.3
    assert 0.0 < varying["least_squares"] < 0.3
    assert {rows["literal"][f"{kind}: more than 90 deg off"] for kind in KINDS} == {4}  # on half of the circle
    assert len(both.means("least_squares")) == 2 * len(HEADS_deg)
    assert len(error_table(both)[0].rows) == 2 * len(HEADS_deg)
    assert [row[2] for row in result_table(both, "least_squares", 1.0).rows] == ["TIP"] * 8 + ["TVP"] * 8


def test_sets_that_name_no_parameters_are_not_divided(both: Solution) -> None:
    plain = solve([a_set("test", 30.0, 1, "", np.random.default_rng(3), 1.0)], Site(37.0, MARK_deg))
    assert parameter_table(plain) == []
    assert plain.kinds == [""]
    assert "parameters" not in result_table(plain, "likelihood", 1.0).headers


def world(**options: Any) -> FogWorld:
    clock = VirtualClock()
    return FogWorld(
        clock=clock, seed=5, options={"noise": False, "wobble_arcmin": 0.0, "placement_arcmin": 0.0, **options}
    )


def test_a_person_lets_the_parameters_of_the_bench_vary_and_be_constant_again() -> None:
    asked, never, always = world(), world(), world(parameters="slow")
    for bench in (asked, never, always):
        bench.motion[0].run_at(360.0, 60.0, 0)
    for at_s, kind in ((30.0, "TVP"), (60.0, "TIP")):
        asked.clock.sleep(at_s - asked.clock.now_ns() / NS)
        asked.operate("parameters", kind)
    number = np.arange(20_000, 80_000)
    output_V, plain_V, slow_V = (bench.sensor.output_V(number) for bench in (asked, never, always))
    varied = (number >= 30_000) & (number < 60_000)
    np.testing.assert_array_equal(output_V[~varied], plain_V[~varied])
    np.testing.assert_array_equal(output_V[varied], slow_V[varied])
    large = varied & (np.abs(plain_V) > 0.5)
    gain = output_V[large] / plain_V[large]
    assert 0.8 - 1e-9 <= gain.min() < 0.9
    assert 1.1 < gain.max() <= 1.2 + 1e-9
