"""Analysis radar_image: points of one formula on an arc of 4 deg, and the Gotcha data of the AFRL against the exact
matched filter (Gorham and Moore, Proc. SPIE 7699 (2010) 769906, the sum over pulses and frequencies) and its nominal
widths.
"""

import re
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest
from imported_logs import MAPPINGS, estimates_of, imported, of_mirror, parsed
from numpy.typing import NDArray
from one_estimate import one
from scipy.io import loadmat, savemat

from bench.analysis import Analysis, Material
from bench.analysis.doubt import weigh
from bench.commands.importing import guess
from bench.model.errors import FitError, InputErrors
from bench.systems.time_sync import phase_history
from bench.systems.time_sync.estimators.sar.response import compressed, impulse_response, scene_of

Array = NDArray[np.float64]
C_m_s = 299_792_458.0
BAND_Hz = (9.5e9, 9.7e9)
COUNT, LENGTH = 96, 64
PLACES_m = np.array([[8.0, -5.0, 0.0], [-9.0, -6.0, 0.0]])
MAPPING = """\
mapping: radar
uut: {model: radar, serial: S-1}
analysis: radar_image
frequencies: {first: 9.5 GHz, last: 9.7 GHz}
columns:
  t: {role: time, format: rows, rate: 100 Hz, start: 2024-01-01T00:00:00Z}
  x: {role: antenna, axis: x, unit: m}
  y: {role: antenna, axis: y, unit: m}
  z: {role: antenna, axis: z, unit: m}
  'NAME[{0..63}].real': {role: in_phase}
  'NAME[{0..63}].imag': {role: quadrature}
"""


def arc(angle_deg: float = 4.0, count: int = COUNT) -> Array:
    """Antenna 5 km away and 4 km up, on a part of a circle about the scene."""
    turn = np.radians(30.0 + angle_deg * (np.arange(count) / (count - 1) - 0.5))
    return np.column_stack((5000.0 * np.cos(turn), 5000.0 * np.sin(turn), np.full(count, 4000.0)))


def echoes(
    antenna_m: Array, places_m: Array = PLACES_m, noise: float = 0.0, seed: int = 1, off_m: Array | float = 0.0
) -> NDArray[np.complex128]:
    """Samples of points of amplitude 1 and 0.5, phase -4 pi f (R - R0) / c; R0 by navigation, which is ``off_m``."""
    frequency_Hz = np.linspace(*BAND_Hz, LENGTH)
    made = np.zeros((len(antenna_m), LENGTH), np.complex128)
    for amplitude, place_m in zip((1.0, 0.5), places_m, strict=False):
        far_m = np.linalg.norm(antenna_m - place_m, axis=1) - np.linalg.norm(antenna_m + off_m, axis=1)
        made += amplitude * np.exp(-4j * np.pi * np.outer(far_m, frequency_Hz) / C_m_s)
    rng = np.random.default_rng(seed)
    return made + noise * (rng.standard_normal(made.shape) + 1j * rng.standard_normal(made.shape)) / np.sqrt(2.0)


def material(samples: NDArray[np.complex128], antenna_m: Array) -> Material:
    series = {f"antenna_{axis}": antenna_m[:, at] for at, axis in enumerate("xyz")}
    for at in range(samples.shape[1]):
        series |= {f"in_phase_{at}": samples[:, at].real.copy(), f"quadrature_{at}": samples[:, at].imag.copy()}
    campaign = {"uut": {"model": "m", "serial": "1"}, "frequencies": {"first_Hz": BAND_Hz[0], "last_Hz": BAND_Hz[1]}}
    return Material((), campaign, {}, series=series)


def found(analysis: Analysis, quantity: str, **where: str) -> tuple[float, float]:
    entry = one(analysis, quantity, **where)
    return entry.value, entry.std_uncertainty


def test_points_of_a_formula_stand_where_they_are_as_sharp_as_they_may_be() -> None:
    """Widths 0.8859 lambda / 2 dsin and 0.8859 c / 2B, first side lobe of sin(x) / x."""
    antenna_m = arc()
    analysis = phase_history.analyse(material(echoes(antenna_m), antenna_m))
    ideal_m = 0.885893 * C_m_s / (2.0 * (BAND_Hz[1] - BAND_Hz[0]) * LENGTH / (LENGTH - 1))
    assert found(analysis, "place_x")[0] == pytest.approx(PLACES_m[0, 0], abs=0.02)
    assert found(analysis, "place_y")[0] == pytest.approx(PLACES_m[0, 1], abs=0.02)
    assert found(analysis, "resolution", axis="range")[0] == pytest.approx(ideal_m, rel=0.01)
    assert found(analysis, "resolution_over_ideal", axis="azimuth")[0] == pytest.approx(1.0, abs=0.01)
    lobes = {axis: found(analysis, "pslr", axis=axis) for axis in ("azimuth", "range")}
    assert all(value == pytest.approx(-13.26, abs=4.0 * std + 0.1) for value, std in lobes.values())
    assert weigh(analysis.evidence).against == []
    table = [row[1:3] for row in analysis.tables[0].rows]
    assert table == [["+8.00", "-5.00"], ["-9.00", "-6.00"]]


def test_intervals_hold_what_noise_does() -> None:
    """Forty draws: root mean square of errors over stated standard uncertainties 0.7 to 1.4 (chi squared, 99.8 %)."""
    antenna_m, place_m = arc(), PLACES_m[:1]

    def values(seed: int, noise: float = 1.0) -> list[tuple[float, float]]:
        pulses = compressed(echoes(antenna_m, place_m, noise, seed), antenna_m, *BAND_Hz)
        target = impulse_response(pulses, antenna_m, scene.targets_m[0], (1.0, 2.0))
        return [(each.value, each.std_uncertainty) for each in phase_history._estimates(scene, target, COUNT, 0)]

    scene = scene_of(compressed(echoes(antenna_m, place_m, 1.0), antenna_m, *BAND_Hz), antenna_m)
    truth = [value for value, _ in values(0, noise=0.0)]
    scores = [
        [(value - true) / std for (value, std), true in zip(values(seed), truth, strict=True)] for seed in range(40)
    ]
    assert np.sqrt(np.mean(np.square(scores), axis=0)) == pytest.approx(np.full(len(truth), 1.05), abs=0.35)


def test_positions_that_are_off_along_the_track_are_seen() -> None:
    antenna_m = arc()

    def image(off_m: Array) -> Analysis:
        return phase_history.analyse(material(echoes(antenna_m, off_m=off_m), antenna_m + off_m))

    bent_m = np.linspace(-1.0, 1.0, COUNT)[:, None] ** 2 * np.array([0.01, 0.0, 0.0])
    analysis = image(bent_m)
    assert found(analysis, "resolution_over_ideal", axis="azimuth")[0] > 1.2
    assert [one.code for one in weigh(analysis.evidence).against] == ["not_focused"]
    with pytest.raises(FitError, match="B-FIT-122: the strongest place"):
        image(10.0 * bent_m)
    shifted = image(np.array([0.3, 0.5, 0.0]))
    assert found(shifted, "place_x")[0] == pytest.approx(PLACES_m[0, 0] + 0.3, abs=0.01)
    assert found(shifted, "place_y")[0] == pytest.approx(PLACES_m[0, 1] + 0.5, abs=0.01)


def test_pulses_that_are_not_whole_are_left_out_and_counted() -> None:
    antenna_m = arc()
    log = material(echoes(antenna_m), antenna_m)
    log.series["quadrature_5"][[4, 9]] = np.nan
    analysis = phase_history.analyse(log)
    assert {(entry.n, entry.dropped) for entry in analysis.estimates} == {(COUNT - 2, 2)}


@pytest.mark.parametrize(
    ("antenna_m", "noise", "said"),
    [
        (arc(count=12), 0.0, "B-SYNC-013: .*12 whole pulses of 64 samples"),
        (arc(angle_deg=30.0), 0.0, r"B-SYNC-013: .*goes 23\..* deg"),
        (arc() * [0.001, 0.001, 1.0], 0.0, "B-SYNC-013: .*above the ground"),
        (arc(angle_deg=0.0), 0.0, "B-FIT-120: .*never change"),
        (arc(), 1e3, "B-SYNC-010: no point target"),
    ],
)
def test_what_is_no_phase_history_is_refused(antenna_m: Array, noise: float, said: str) -> None:
    with pytest.raises(FitError, match=said):
        phase_history.analyse(material(echoes(antenna_m, noise=noise), antenna_m))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("role: quadrature", "role: in_phase", "two columns have the quantity 'in_phase_0'"),
        ("{0..63}].imag", "{0..62}].imag", "as many columns"),
        ("{0..63}].imag", "{63..0}].imag", "needs the numbers of its columns"),
        ("'NAME[{0..63}].imag'", "Q", "needs the numbers of its columns"),
        ("axis: z, unit: m", "axis: z, unit: s", "unit of length"),
        ("last: 9.7 GHz", "last: 9.4 GHz", "above the first"),
        ("frequencies: {first: 9.5 GHz, last: 9.7 GHz}\n", "", "and 'frequencies'"),
        ("role: in_phase", "role: samples", "'time', 'antenna', 'in_phase', 'quadrature', 'temperature', 'ignore'"),
    ],
)
def test_mistakes_of_a_mapping_are_named(old: str, new: str, said: str) -> None:
    with pytest.raises(InputErrors, match=said):
        parsed(MAPPING.replace(old, new))


@pytest.mark.parametrize("form", ["mat", "npz", "matlab_hdf5", "csv"])
def test_a_phase_history_of_every_form(form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The rows of the matrix are frequencies in MATLAB, as in the Gotcha data, pulses in NumPy and in text."""
    antenna_m, log, name = arc(), BytesIO(), "fp.T"
    samples = echoes(antenna_m)
    columns = dict(zip("xyz", antenna_m.T, strict=True))
    if form == "mat":
        savemat(log, {"fp": samples.T, **columns})
    elif form == "npz":
        name = "fp"
        np.savez(log, fp=samples, **columns)
    elif form == "matlab_hdf5":
        with h5py.File(log, "w") as file:
            parts = np.empty(samples.shape, [("real", "f8"), ("imag", "f8")])
            parts["real"], parts["imag"] = samples.real, samples.imag
            for key, array in {"fp": parts, **{key: value[None] for key, value in columns.items()}}.items():
                file[key] = array
                file[key].attrs["MATLAB_class"] = np.bytes_("double")
    else:
        name = "s"
        header = ",".join([*"xyz", *(f"s[{k}].{part}" for k in range(LENGTH) for part in ("real", "imag"))])
        table = np.column_stack((antenna_m, samples.view(np.float64)))
        np.savetxt(log, table, delimiter=",", header=header, comments="", fmt="%.17g")
    entries = estimates_of(imported(tmp_path, MAPPING.replace("NAME", name), log.getvalue()))
    assert entries[0].value == pytest.approx(PLACES_m[0, 0], abs=0.02)
    capsys.readouterr()
    guess(tmp_path / "log")
    assert re.search(r"\[\{0\.\.\d+\}\]\.imag': \{role: quadrature\}", capsys.readouterr().out)


@pytest.mark.real
def test_the_gotcha_scene_is_as_sharp_as_its_band_and_aperture(tmp_path: Path) -> None:
    """Its strongest reflector: 0.8859 c / 2B in range to 3 % (the band is not quite flat), in azimuth to 1 %."""
    capture = of_mirror("dm6718+RITSAR", "examples/data/AFRL/pass1/HH/data_3dsar_pass1_az001_HH.mat")
    entries = estimates_of(imported(tmp_path, MAPPINGS / "gotcha_phase_history.yaml", capture))
    found = {(entry.quantity, entry.conditions.get("axis")): entry.value for entry in entries}
    log = loadmat(BytesIO(capture), squeeze_me=True, struct_as_record=False)["data"]
    antenna_m, frequency_Hz = np.column_stack((log.x, log.y, log.z)).astype(float), log.freq.astype(float)
    cosine = np.mean(np.hypot(log.x, log.y) / np.linalg.norm(antenna_m, axis=1))
    turned = np.radians(log.th[-1] - log.th[0]) * len(antenna_m) / (len(antenna_m) - 1) * cosine
    assert found["resolution", "azimuth"] == pytest.approx(
        0.885893 * C_m_s / frequency_Hz.mean() / (2.0 * turned), rel=0.01
    )
    assert found["resolution", "range"] == pytest.approx(0.885893 * C_m_s / (2.0 * 424 / 423 * 622.361e6), rel=0.03)
    assert found["pslr", "azimuth"] == pytest.approx(-13.26, abs=1.0)
    scene = scene_of(compressed(log.fp.T.astype(complex), antenna_m, 9.28808e9, 9.910441e9), antenna_m)
    highest = np.abs(scene.chip.value).max()
    picked = np.random.default_rng(1).integers(0, scene.chip.value.shape, (40, 2))
    for row, column in picked:
        point_m = scene.axes.points(scene.chip.azimuth_m[row], scene.chip.range_m[column])
        far_m = np.linalg.norm(antenna_m - point_m, axis=1) - np.linalg.norm(antenna_m, axis=1)
        exact = np.mean(log.fp.T * np.exp(4j * np.pi * np.outer(far_m, frequency_Hz) / C_m_s))
        assert abs(abs(exact) - abs(scene.chip.value[row, column])) < 5e-4 * highest
