"""Station files: the register of standards, the safe order, ranges, and the options of the world."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.model.errors import InputErrors
from bench.model.shipped import find_shipped
from bench.plan import Station, load_station


@pytest.fixture(scope="module")
def station() -> Station:
    return load_station(find_shipped("stations", "af_bench_sim"))


def test_ten_instruments_at_ten_addresses(station: Station) -> None:
    resources = [entry["resource"] for entry in station.wiring()["instruments"].values()]
    assert len(resources) == len(set(resources)) == 10
    assert set(station.wiring()["links"]) == {"port_a", "port_b"}
    assert station.simulated


def test_the_current_goes_off_before_a_relay_moves_and_power_goes_last(station: Station) -> None:
    order = station.safe_order
    assert order[:3] == ("calibrator", "switch", "chamber")
    assert order.index("supply") > order.index("aux_supply") > order.index("function_generator")


def test_the_register_of_standards_is_in_si_units(station: Station) -> None:
    standards = station.standards()
    assert set(standards) == set(station.instruments)
    calibrator = standards["calibrator"]
    assert calibrator["due"] == "2000-11-01"
    table_2 = [
        (2.2e-4, 2e-5, 6e-9),
        (2.2e-3, 2e-5, 7e-9),
        (2.2e-2, 2e-5, 4e-8),
        (0.22, 2e-5, 7e-7),
        (2.2, 3.2e-5, 1.2e-5),
    ]
    assert [(u["range_A"], u["relative"], u["floor_A"]) for u in calibrator["uncertainty"]] == table_2
    assert all(c["gain"] == c["offset_A"] == 0.0 for c in calibrator["corrections"])


def test_ranges_of_a_standard_come_lowest_first(station: Station) -> None:
    assert station.ranges_A("calibrator") == (2.2e-4, 2.2e-3, 2.2e-2, 0.22, 2.2)


def test_a_role_without_a_standard_has_no_ranges(station: Station) -> None:
    assert station.ranges_A("nobody") == ()


def test_options_left_to_the_world_are_absent_until_they_are_set(station: Station) -> None:
    assert "master_error_ppm" not in station.world_options
    assert station.with_options({"master_error_ppm": "-50"}).world_options["master_error_ppm"] == "-50"
    assert "master_error_ppm" not in station.world_options


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"2000-11-01"', '"1.11.2000"', "'1.11.2000' is not a date; write YYYY-MM-DD"),
        ("links:", "guard: {limits: {chamber_air: 50 degC}}\nlinks:", "hard limit chamber_air of 50 degC is not above"),
    ],
)
def test_a_mistake_in_a_station_file_says_what_is_due(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "mine.yaml"
    text = find_shipped("stations", "af_bench_sim").read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputErrors) as caught:
        load_station(path)
    assert words in str(caught.value)
