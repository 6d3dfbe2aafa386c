"""The survey of logs of other people: what it says, and that no spoiled log gives a wrong sound number or an error."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from imported_logs import RAMP, imported, ramp_rows, write_ramp
from spoiled_logs import LOGS, SIZES, SPOILT, Log, at_rest, held, outcome, ramp, twice, wrong

from bench.analysis import Material
from bench.analysis.survey import surveyed
from bench.maths.samples import sentinel
from bench.maths.stamps import sample_stamps
from bench.model.errors import FitError


def told(log: Log, **columns: np.ndarray) -> tuple[list[str], list[str], Material]:
    seen = surveyed(Material((), log.campaign, {}, series=log.columns | columns))
    return seen.notes, [check.sentence for check in seen.evidence], seen.material


def test_a_right_log_is_left_as_it_is() -> None:
    for make in LOGS.values():
        log = make(np.random.default_rng(1))
        assert told(log)[:2] == ([], [])


@pytest.mark.parametrize(("spoil", "times"), [(twice, 2), (held, 5)])
def test_rows_that_say_the_same_again_are_left_out_and_told(spoil, times: int) -> None:
    log = at_rest(np.random.default_rng(1))
    columns = spoil(log.columns, 1.0, np.random.default_rng(2))
    ((note,), evidence, material) = told(log, **columns)
    rows = columns["t_s"].size
    said = "rows say again what the row before said: the sensor gives a value for"
    assert note == f"{rows - rows // times} of {rows} {said} {times} rows. They are left out."
    assert (evidence, material.series["gz"].size) == ([], rows // times)


def test_a_coarse_sensor_repeats_nothing() -> None:
    log = at_rest(np.random.default_rng(1))
    coarse = {name: np.round(log.columns[name] / 0.05) * 0.05 for name in ("gz", "ax", "ay", "az")}
    assert told(log, **coarse)[:2] == ([], [])


def test_a_clock_that_is_set_forward_is_refused_and_a_pause_is_not() -> None:
    log = ramp(np.random.default_rng(1))
    columns = log.columns | {"t_s": log.columns["t_s"] + np.where(np.arange(2520) > 600, 3600.0, 0.0)}
    with pytest.raises(FitError, match="B-FIT-144: row 602: the time jumps forward by 3610 s behind row 601, while c"):
        told(log, **columns)
    kept = np.delete(np.arange(2520), slice(600, 700))
    (note,) = told(replace(log, columns={name: values[kept] for name, values in log.columns.items()}))[0]
    assert note == (
        "Pauses in the log: 1, 1010 s in all; the longest, 1010 s, is behind row 600. Nothing is filled in."
    )


@pytest.mark.parametrize("code", [85.0, 9.9e37])
def test_rows_with_a_code_for_no_reading_are_left_out_and_told(code: float) -> None:
    log = ramp(np.random.default_rng(1))
    sensor = log.columns["sensor"].copy()
    sensor[700:760] = code
    notes, evidence, material = told(log, sensor=sensor)
    rest = "far from all others, first in row 701: a code for no reading. These rows are left out."
    assert notes[0] == f"sensor is {code:g} in 60 rows, {rest}"
    assert (evidence, material.series["U"].size) == ([], 2460)
    assert {entry.dropped for entry in outcome(log, log.columns | {"sensor": sensor})[1].values()} == {60}
    six = LOGS["imu_six_position"](np.random.default_rng(1))
    assert "State it in the mapping" in told(six, ax=np.where(np.arange(4500) % 50, six.columns["ax"], code))[1][0]


def test_an_import_tells_at_the_terminal_what_was_seen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = ramp_rows(1)
    rows["s1"][700:720] = 85.0
    imported(tmp_path, RAMP, write_ramp(tmp_path / "ramp.csv", rows).read_bytes())
    said = " ".join(capsys.readouterr().out.split())
    assert "s1 is 85 in 20 rows, far from all others, first in row 701: a code for no reading." in said


def test_rows_off_the_surface_of_a_magnetometer_are_counted_as_dropped() -> None:
    log = LOGS["magnetometer_log"](np.random.default_rng(1))
    far = log.columns["mx"] + np.isin(np.arange(1500), np.arange(700, 712)) * 3.0
    assert {entry.dropped for entry in outcome(log, log.columns | {"mx": far})[1].values()} == {12}


def test_a_column_without_readings_is_refused() -> None:
    log = ramp(np.random.default_rng(1))
    with pytest.raises(FitError, match="B-FIT-145: the column sensor has one and the same value in all rows"):
        told(log, sensor=np.zeros(2520))
    with pytest.raises(FitError, match="B-FIT-145: of 2520 rows 2520 hold codes for no reading"):
        told(log, sensor=np.full(2520, 9.91e37))
    assert sentinel(log.columns["U"]) is None
    assert sentinel(np.repeat(np.arange(20.0), 100)) is None  # levels without noise


def test_gravity_says_the_unit() -> None:
    log = at_rest(np.random.default_rng(1))
    triad = {name: log.columns[name] / 9.80665 for name in ("ax", "ay", "az")}
    (sentence,) = told(log, **triad)[1]
    assert "m/s2 where gravity is 9.807 m/s2: their unit is g. Correct the unit in the mapping." in sentence
    half = {name: log.columns[name] / 2.0 for name in ("ax", "ay", "az")}
    (sentence,) = told(log, **half)[1]
    assert "Check unit and scale of their columns" in sentence


def test_stamps_tell_rate_gaps_and_bursts() -> None:
    rng, even = np.random.default_rng(1), np.arange(60_000) * 0.01
    for missing in (0.1, 0.5):
        found = sample_stamps(even[rng.random(even.size) > missing])
        assert (found.rate_Hz, found.bursty, found.sure) == (pytest.approx(100.0), False, True)
    paused = np.where(np.arange(even.size) > 30_000, even + 86_400.0, even)
    found = sample_stamps(paused)
    assert (found.rate_Hz, found.missing) == (pytest.approx(100.0), 8_640_000)
    many = np.concatenate([even[k * 3000 : k * 3000 + 300] for k in range(20)])  # nine tenths are pauses
    assert (sample_stamps(many).rate_Hz, sample_stamps(many).bursty) == (pytest.approx(100.0), False)
    bursts = even[np.minimum((np.arange(even.size) // 10 + 1) * 10 - 1, even.size - 1)]
    found = sample_stamps(np.where(np.arange(even.size) > 30_000, bursts + 600.0, bursts))
    assert (found.rate_Hz, found.bursty, len(found.breaks)) == (pytest.approx(100.0, rel=0.01), True, 1)
    erratic = np.repeat(np.cumsum(rng.exponential(1.0, 200)), 7)
    assert not sample_stamps(erratic).sure
    log = at_rest(rng)
    rows = {name: np.resize(values, erratic.size) for name, values in log.columns.items()}
    (sentence,) = told(replace(log, columns=rows), t_s=erratic)[1]
    assert sentence.startswith("The time stamps tell no rate: rows come in bursts that are not alike")


def test_many_lone_values_of_a_ramp_are_a_doubt() -> None:
    log = ramp(np.random.default_rng(8))
    values = log.columns["U"] + np.where(np.arange(log.columns["U"].size) % 40, 0.0, 1e-5)
    assert outcome(log, log.columns)[1]
    assert outcome(log, log.columns | {"U": values}) == ("", {})
    hot = np.where(np.arange(values.size) % 40, log.columns["sensor"], 9.9e37)
    assert outcome(log, log.columns | {"sensor": hot})[1]


@pytest.mark.parametrize("kind", SPOILT)
def test_a_spoiled_log_gives_no_wrong_sound_number(kind) -> None:
    worlds = (*product(LOGS, (1.0,)), ("temperature_ramp", 0.2))
    assert [line for analysis, size in worlds for line in wrong(analysis, kind, size, 0)] == []


@pytest.mark.sweep
def test_five_hundred_spoiled_logs() -> None:
    worlds = list(product(LOGS, SPOILT, SIZES))
    lines = [line for k in range(504) for line in wrong(*worlds[k % len(worlds)], k // len(worlds))]
    print("\n".join(lines))
    by_chance = [line for line in lines if "quantisation_noise" in line]  # a short term is false in 1 % of sensors
    assert len(by_chance) <= 10
    assert lines == by_chance
