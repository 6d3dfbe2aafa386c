"""North finding through drivers, simulated lock-ins, serial port and records, against the simulated truth."""

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from bench.cli import app

SHORT = ("warm_up=30 s", "record_time=5 s", "calibration=1", "repeats=1", "search=1", "heads=0 deg,90 deg",
         "time_constant=1 s", "settle=20 s")  # fmt: skip
SEED = 21


def run(out: Path, *settings: str) -> Path:
    """The folder of a whole campaign; whatever its verdicts are."""
    chosen = dict(one.split("=", 1) for one in (*SHORT, *settings))
    sets = [word for name, value in chosen.items() for word in ("--set", f"{name}={value}")]
    words = ["run", "fog_north", "--clock", "virtual", "--seed", str(SEED), "--truth", "--out", str(out), *sets]
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
    """Rotation axis 10 and 6 minutes of arc off, harmonics, misplaced marks; the swing of the table is taken away."""
    tilted = ("world.rotation_tilt_arcmin=10", "world.rotation_tilt_east_arcmin=6", "world.harmonic_3_ppm=10000")
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
