"""What is left out and named, what departs just below and well above what is doubted, and the analysis of a log."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import doubt_north as worlds
import numpy as np
import pytest
from fog_material import AZIMUTH_DEG, Gyro, NorthRig, campaign
from one_estimate import every

from bench.analysis import build_results, estimates_of
from bench.commands.import_log import import_log
from bench.model.errors import FitError, InputErrors
from bench.model.yamlio import parse_yaml
from bench.plan.language.mapping import mapping_model
from bench.systems.north.analysis import analyse
from bench.systems.north.assumptions import assumptions
from bench.systems.north.estimators.likelihood import likelihood_north
from bench.systems.north.estimators.phasors import wrapped_deg
from bench.systems.north.sets import north_sets
from bench.systems.north.solve import site_of, solve

SEED = 1811
PROVENANCE = {"simulated": True, "plan_sha256": "a", "frame_sha256": "b", "session_sha256": "c", "software": "x 1"}


@pytest.fixture(autouse=True)
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the time of an analysis is that of its figures."""
    for name in ("signal_figures", "error_figures"):
        monkeypatch.setattr(f"bench.systems.north.analysis.{name}", lambda *_: [])


def material_of(world: worlds.World, seed: int = SEED) -> Any:
    return worlds._material(seed, world, 1.0)


def test_the_size_of_a_wave_is_that_of_ordinary_least_squares() -> None:
    """Errors of likelihood at all known azimuths on sine and cosine of the heading, by hand; the mark is known well."""
    material = material_of(worlds.ONCE_PER_TURN(0.1))
    (seen,) = (one for one in analyse(material).evidence if one.code == "departs")
    solution = solve(north_sets(material), site_of(material.campaign))
    error_deg = wrapped_deg(solution.by_method["likelihood"].azimuth_deg - solution.known_deg)
    known = np.isfinite(error_deg)
    angle = np.deg2rad(solution.known_deg[known])
    wave = np.linalg.lstsq(np.column_stack((np.sin(angle), np.cos(angle))), error_deg[known], rcond=None)[0]
    assert seen.figure == pytest.approx(np.hypot(*wave), rel=0.01)


def refused_for(rig: NorthRig, code: str) -> set[str]:
    """Return the methods whose azimuth is refused for this reason in results.json."""
    entries = estimates_of(build_results("one", analyse(rig.material(), "likelihood"), {}, PROVENANCE))
    lost = [entry for entry in entries if entry.quality == "refused"]
    return {entry.conditions["method"] for entry in lost if code in {reason.code for reason in entry.reasons}}


@pytest.mark.parametrize("rate_deg_s", [-360.0, 330.0])
def test_a_rate_or_sense_that_is_stated_wrong_leaves_nothing_of_the_lock_ins(rate_deg_s: float) -> None:
    """Lock-ins that tell no frequency are held against the encoder."""
    rig = campaign(NorthRig(SEED, Gyro(noise_V=0.01)), (0.0, 90.0), 1)
    for row in rig.rows:
        row.window.conditions["rate_deg_s"] = rate_deg_s
    with pytest.raises(FitError, match=r"B-FIT-111|the table turns at"):
        analyse(rig.material(), "least_squares")
    if rate_deg_s > 0.0:
        material = rig.material()
        for reading in material.readings:
            reading.value.pop("frequency_Hz", None)
        document = build_results("one", analyse(material, "least_squares"), {}, PROVENANCE)
        entry = every(estimates_of(document), "azimuth_error", method="least_squares")[0]
        assert (entry.quality, [one.code for one in entry.reasons]) == ("doubtful", ["rate_not_as_stated"])


def test_a_signal_that_drowns_is_refused() -> None:
    assert "likelihood" in refused_for(campaign(NorthRig(SEED, Gyro(noise_V=100.0)), (0.0, 90.0), 1), "no_signal")
    assert refused_for(campaign(NorthRig(SEED, Gyro(noise_V=2.0)), (0.0, 90.0), 1), "no_signal") == set()


def test_one_bad_reading_costs_its_set_and_is_named_as_a_lock_in_that_stands_still() -> None:
    bad = analyse(material_of(worlds.ONE_BAD_READING(0.1)))
    (sentence,) = bad.missing
    assert "test at head 90 deg, repeat 1: lock_in_1 reads" in sentence
    (entry,) = (one for one in bad.estimates if one.quantity == "azimuth_error" and one.conditions["head_deg"] == 90.0)
    assert (entry.n, entry.dropped) == (1, 1)
    assert analyse(material_of(worlds.ONE_BAD_READING(1e-3))).missing == []
    rig = campaign(NorthRig(SEED, Gyro(noise_V=0.01)), (0.0, 90.0), 1)
    stuck = [k for k, one in enumerate(rig.readings) if one.role == "lock_in_2"][4:8]
    for k in stuck[1:]:
        rig.readings[k] = replace(rig.readings[k], value=rig.readings[stuck[0]].value)
    (sentence,) = analyse(rig.material()).missing
    assert "lock_in_2 handed over the same value three times in a row" in sentence


def test_one_far_sample_is_left_out_and_named_without_a_loss() -> None:
    spiked, right = (analyse(material_of(worlds.SPIKE(size))) for size in (100.0, 0.0))
    assert any("1 of 3000 samples are unlike all others" in note for note in spiked.notes)
    assert spiked.missing == []
    values = [[one.value for one in each.estimates if one.quantity == "azimuth"] for each in (spiked, right)]
    np.testing.assert_allclose(*values, atol=0.02)


@pytest.mark.parametrize(
    ("world", "said"),
    [(worlds.FROZEN(0.1), "output stands still for 76 samples"), (worlds.CLIPPED(0.9), "samples are pinned at 1.1 V")],
)
def test_a_waveform_that_stands_still_or_is_pinned_is_left_out(world: worlds.World, said: str) -> None:
    analysis = analyse(material_of(world))
    assert any(said in sentence for sentence in analysis.missing)
    assert not any(one.conditions.get("source") == "waveform" for one in analysis.estimates)


def test_assumptions_say_their_sizes_in_this_campaign() -> None:
    site = {"latitude_deg": 37.0, "azimuth_deg": AZIMUTH_DEG, "azimuth_std_deg": 0.02}
    texts = {one.code: one for one in assumptions({"site": site})}
    assert "0.12 deg/h" in texts["magnetic_effect"].unseen  # 1 % of 15.041 cos 37 deg
    assert "0.02 deg" in texts["azimuth_of_mark"].taken_for_granted
    assert "0.0432 deg" in texts["latitude"].effect  # 1 mrad times tan 37 deg


SAMPLES = """\
mapping: north
uut: {model: FOG, serial: S-1}
analysis: north_log
columns:
  t: {role: time, format: elapsed, unit: s, start: 2024-01-01T00:00:00Z}
  U: {role: output, unit: mV}
  angle: {role: encoder, unit: deg}
"""
READINGS = """\
mapping: north
uut: {model: FOG, serial: S-1}
analysis: north_log
turntable: counter_clockwise
columns:
  t: {role: time, format: elapsed, unit: s, start: 2024-01-01T00:00:00Z}
  a: {role: lock_in_1, unit: mV}
  b: {role: lock_in_2, unit: mV}
  k: {role: index}
"""


def found(folder: Path, mapping: str, header: str, table: np.ndarray, status: int = 0) -> list[dict[str, float]]:
    folder.mkdir(exist_ok=True)
    (folder / "m.yaml").write_text(mapping, encoding="utf-8")
    np.savetxt(folder / "log.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    assert import_log(folder / "m.yaml", folder / "log.csv", folder / "out") == status
    (results,) = (folder / "out").glob("*/results.json")
    return estimates_of(json.loads(results.read_bytes()))


def samples(heading_deg: float, sense: int, noise: float = 0.5) -> np.ndarray:
    """A turn a second for 60 s at 500 Hz: 1 V cos(H0 - theta), offset, noise; the paper's equation (1)."""
    t_s = np.arange(0.0, 60.0, 0.002)
    theta = np.mod(sense * 360.0 * t_s, 360.0)
    volts = np.cos(np.radians(heading_deg - theta)) + 0.3
    return np.column_stack((t_s, 1e3 * (volts + np.random.default_rng(5).normal(0.0, noise, t_s.size)), theta))


@pytest.mark.parametrize(("heading_deg", "sense"), [(63.4, 1), (181.0, -1), (359.0, 1)])
def test_samples_give_the_heading_they_were_made_with(heading_deg: float, sense: int, tmp_path: Path) -> None:
    azimuth, amplitude = found(tmp_path, SAMPLES, "t,U,angle", samples(heading_deg, sense))
    off = (azimuth.value - heading_deg + 180.0) % 360.0 - 180.0
    assert abs(off) < 1.5 * azimuth.expanded_uncertainty
    bound_deg = np.degrees(0.5 * np.sqrt(2.0 / 30_000))  # Cramer-Rao: sqrt(2/N) of noise over amplitude
    assert azimuth.std_uncertainty == pytest.approx(bound_deg, rel=0.05)
    assert amplitude.value == pytest.approx(1.0, abs=0.02)


def test_a_ramp_of_the_output_is_doubted_by_what_a_column_for_it_moves(tmp_path: Path) -> None:
    """Against ordinary least squares of the samples, with a column of time and without it."""
    table = samples(63.4, 1)
    little, ramp = (table + np.outer(table[:, 0] / 60.0, [0.0, 1e3 * size_V, 0.0]) for size_V in (0.1, 6.0))
    assert found(tmp_path, SAMPLES, "t,U,angle", little)[0].quality == "sound"
    (reason,) = found(tmp_path / "ramp", SAMPLES, "t,U,angle", ramp, status=1)[0].reasons
    assert (reason.code, reason.figure) == ("departs", pytest.approx(600.0, rel=0.05))  # % of the signal
    assert "Offset of the output (in % of the signal), drift" in reason.sentence
    angle, volts = np.radians(ramp[:, 2]), 1e-3 * ramp[:, 1]
    columns = [function(k * angle) for k in range(1, 6) for function in (np.sin, np.cos)] + [np.ones(angle.size)]
    both = [np.linalg.lstsq(np.column_stack(one), volts, rcond=None)[0] for one in (columns, [*columns, ramp[:, 0]])]
    phasors = [complex(one[0], one[1]) for one in both]
    turned_deg, grown_V = np.degrees(np.angle(phasors[1] / phasors[0])), abs(phasors[1]) - abs(phasors[0])
    wide = likelihood_north(volts, ramp[:, 2], harmonics=(2, 3, 4, 5))
    moves = [abs(turned_deg) / wide.half_width_deg(), abs(grown_V) / (1.96 * wide.noise_V * np.sqrt(2.0 / volts.size))]
    assert float(reason.sentence.split("up to ")[1].split()[0]) == pytest.approx(max(moves), rel=0.1)


def test_noise_alone_is_refused_and_ends_with_status_1(tmp_path: Path) -> None:
    noise = samples(63.4, 1)
    noise[:, 1] = np.random.default_rng(8).normal(0.0, 1e3, len(noise))
    azimuth, _ = found(tmp_path, SAMPLES, "t,U,angle", noise, status=1)
    assert (azimuth.quality, azimuth.value) == ("refused", None)


@pytest.mark.parametrize(("turntable", "sense"), [("counter_clockwise", 1), ("clockwise", -1)])
def test_readings_of_lock_ins_give_the_heading(turntable: str, sense: int, tmp_path: Path) -> None:
    """Equations (13) and (14): phi = 90 deg - H0, or 90 deg + H0 clockwise, where lock-in 1 changes its sign."""
    heading_deg, sets, k = 200.0, 40, np.tile(np.arange(4), 40)
    phi = np.radians(90.0 - sense * heading_deg + 90.0 * k)
    noise = np.random.default_rng(6).normal(0.0, 50.0, (2, k.size))
    signals = sense * 1e3 * np.sin(phi) + 20.0 + noise[0], 1e3 * np.cos(phi) - 5.0 + noise[1]
    table = np.column_stack((np.arange(k.size), *signals, k))
    mapping = READINGS.replace("counter_clockwise", turntable)
    (azimuth,) = found(tmp_path, mapping, "t,a,b,k", table)
    assert azimuth.value == pytest.approx(heading_deg, abs=1.5 * azimuth.expanded_uncertainty)
    assert azimuth.std_uncertainty == pytest.approx(np.degrees(0.05 / np.sqrt(8 * sets / 2)), rel=0.2)
    turned = (table[:, 2] + 1j * table[:, 1]) * np.exp(1j * np.radians(5.0) * (table[:, 0] >= 80))  # from the middle on
    table[:, 1], table[:, 2] = turned.imag, turned.real
    (reason,) = found(tmp_path / "steps", mapping, "t,a,b,k", table, status=1)[0].reasons
    assert (reason.code, abs(reason.figure)) == ("departs", pytest.approx(5.0, rel=0.15))


def test_what_does_not_belong_together_is_refused(tmp_path: Path) -> None:
    table = np.column_stack((np.arange(8), np.ones(8), np.ones(8), [0, 1, 2, 3, 0, 1, 3, 2]))
    with pytest.raises(FitError, match=r"B-FIT-110: .*8 rows"):
        found(tmp_path, READINGS, "t,a,b,k", table)
    for old, new, said in (
        ("unit: deg}", "unit: mV}", "an encoder needs a unit of angle"),
        ("role: encoder", "role: index", "needs columns of the roles output and encoder"),
        ("role: output", "role: signal", "'time', 'output', 'encoder', 'lock_in_1'"),
    ):
        with pytest.raises(InputErrors) as raised:
            parse_yaml(SAMPLES.replace(old, new), "m.yaml", mapping_model())
        assert said in str(raised.value)
    with pytest.raises(InputErrors, match="need 'turntable"):
        parse_yaml(READINGS.replace("turntable: counter_clockwise\n", ""), "m.yaml", mapping_model())
