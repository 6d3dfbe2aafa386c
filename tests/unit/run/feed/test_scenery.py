"""What a run is shown with: channels by number and kind, rates in the unit of what a pulse stands for, limits."""

from __future__ import annotations

from typing import Any

import pytest
from run_rig import ROOT

from bench.frame import load_frame
from bench.plan import Findings, graphs_of, load_station, shown_signals
from bench.plan.check.stations import station_rules
from bench.run.feed.scenery import graph_rows, limit_rows, signal_rows

FRAMES = {"port_a": load_frame(ROOT / "frames" / "ngu_a.yaml"), "port_b": load_frame(ROOT / "frames" / "ngu_b.yaml")}
STATION = load_station(ROOT / "stations" / "af_bench_sim.yaml")
GRAPHS = graphs_of(STATION.file.graphs, FRAMES, "port_a")
SIGNALS = shown_signals(GRAPHS, FRAMES)
GYRO = {"kind": "gyro", "k0_C": 1.25e-6, "full_scale_A": 0.299}
ACCELEROMETER = {"kind": "accelerometer", "k0_C": 0.1e-6, "full_scale_A": 0.0242}


def manifest(analysis: str = "scale_factor", **channels: dict[str, Any]) -> dict[str, Any]:
    entries = [{"number": int(name[1:]), **channel} for name, channel in channels.items()]
    return {"measurement_link": "port_a", "campaign": {"analysis": analysis, "channels": entries}}


def test_rates_are_currents_of_the_channels_that_the_campaign_declares() -> None:
    gyros, accelerometers, temperature = graph_rows(GRAPHS, SIGNALS, manifest(c1=GYRO, c3=GYRO, c7=ACCELEROMETER))
    assert gyros["rates"]["signals"] == ["port_a.npp-ppp[1]/s", "port_a.npp-ppp[3]/s"]
    assert (gyros["rates"]["unit"], gyros["rates"]["decimals"], gyros["rates"]["mean_s"]) == ("mA", 3, 1.0)
    assert 8000 * gyros["rates"]["factors"][0] == pytest.approx(10.0)  # 10 mA are 8000 pulses of 1.25 uC in a second
    assert 100_000 * accelerometers["rates"]["factors"][0] == pytest.approx(10.0)
    assert accelerometers["rates"]["decimals"] == 4
    assert temperature["rates"] is None
    assert list(gyros["signals"]) == [f"port_a.npp-ppp[{channel}]" for channel in range(1, 7)]


@pytest.mark.parametrize(
    "without", [manifest(), manifest("north", c1=GYRO), manifest(c1={"kind": "gyro"}), {"measurement_link": "port_a"}]
)
def test_without_what_a_pulse_stands_for_a_rate_is_in_pulses(without: dict[str, Any]) -> None:
    rates = graph_rows(GRAPHS, SIGNALS, without)[0]["rates"]
    assert (rates["unit"], rates["factors"], len(rates["signals"])) == ("pulse/s", [1.0] * 6, 6)


def test_a_signal_names_the_channel_it_counts() -> None:
    rows = {row["name"]: row["channel"] for row in signal_rows(SIGNALS, manifest(c3=GYRO))}
    assert rows["port_a.npp-ppp[3]/s"] == rows["port_a.npp[3]"] == {"number": 3, "kind": "gyro"}
    assert rows["port_a.ppp[4]"] == {"number": 4, "kind": None}
    assert rows["port_b.unit_temperature[1]"] is None
    assert rows["port_a.af_clock"] is None


def test_limits_are_those_that_the_station_and_its_guard_have() -> None:
    rows = limit_rows(station_rules(STATION, Findings()).values(), STATION.guard_limits_degC)
    assert [(row["name"], row["of"], row["low_degC"], row["high_degC"]) for row in rows] == [
        ("chamber_air", "air", -43.0, 63.0), ("second_air", "air", None, 63.0), ("unit_hot", "unit", None, 65.0),
        ("guard", "air", None, 65.0), ("guard", "unit", None, 70.0),
    ]  # fmt: skip
    assert {row["action"] for row in rows} == {"abort", "guard"}
