"""The graphs of a station: checked, kept where it is served, derived where there are none."""

from __future__ import annotations

from datetime import date
from pathlib import Path

import pytest
from plan_sample import make_bench, mistakes
from trend_sample import FRAMES, ROOT

from bench.frame import load_frame
from bench.model.yamlio import parse_yaml
from bench.plan import load_station
from bench.plan.language.graphs import GraphEntry, graphs_of, shown_signals
from bench.plan.served import served_station
from bench.plan.station import StationFile
from bench.replay.described import session_graphs, session_signals

WRONG = '["port_a.npp-ppp[1..6]"]'


@pytest.mark.parametrize(
    ("signals", "code", "said"),
    [
        ('["port_a.nppx[1..6]"]', "B-PLAN-084", "did you mean 'port_a.npp[1..10]'"),
        ('["port_x.npp[1]"]', "B-PLAN-084", "no link 'port_x'"),
        ('["port_a.npp[1..6]", "port_a.ppp[1..6]"]', "B-PLAN-085", "12 curves"),
        ("[bench.air, port_b.supply_voltage]", "B-PLAN-086", "V and degC"),
    ],
)
def test_a_wrong_graph_is_one_clear_mistake(tmp_path: Path, signals: str, code: str, said: str) -> None:
    found = mistakes(make_bench(tmp_path, station=(WRONG, signals)))
    assert [error.code for error in found] == [code]
    assert said in found[0].message
    assert "af_bench_sim.yaml:" in found[0].where


@pytest.mark.parametrize("name", ["af_bench_sim", "af_rack_sim"])
def test_the_shipped_stations_draw_gyros_accelerometers_and_temperature(name: str) -> None:
    station = load_station(ROOT / "stations" / f"{name}.yaml")
    gyros, accelerometers, temperature = graphs_of(station.file.graphs, FRAMES)
    assert gyros.signals == tuple(f"port_a.npp-ppp[{channel}]" for channel in range(1, 7))
    assert accelerometers.signals == tuple(f"port_a.npp-ppp[{channel}]" for channel in range(7, 11))
    assert (gyros.unit, gyros.window_s) == ("pulse", 60.0)
    assert (temperature.unit, temperature.window_s) == ("degC", 600.0)
    served = served_station(
        station, dict.fromkeys(station.instruments, "TCPIP0::h::hislip0::INSTR"),
        dict.fromkeys(station.links, "/dev/null"), Path("/control.sock"), date(2026, 1, 1),
    )  # fmt: skip
    assert parse_yaml(served, "served.yaml", StationFile).model.graphs == station.file.graphs


def test_without_graphs_there_are_some_that_suit_the_frames() -> None:
    titles = [(graph.title, graph.unit, len(graph.signals)) for graph in graphs_of([], FRAMES, "port_a")]
    assert titles == [
        ("port_a.npp-ppp", "pulse", 10), ("port_b.unit_temperature", "degC", 4), ("Temperature", "degC", 3),
    ]  # fmt: skip
    other = graphs_of([], {"imu": load_frame(ROOT / "frames" / "vn100_binary.yaml")}, "imu")
    assert [graph.unit for graph in other] == ["G", "m/s2", "degC"]
    assert other[0].signals[:2] == ("imu.mag_x", "imu.mag_y")
    assert [graph.title for graph in graphs_of([], {})] == ["Temperature"]


def test_a_signal_that_these_frames_lack_is_left_out() -> None:
    entry = GraphEntry(title="one", signals=["port_a.npp[1]", "port_z.npp[1]", "port_a.npp[1]"])
    assert graphs_of([entry], FRAMES)[0].signals == ("port_a.npp[1]",)
    assert "port_a.npp[1]/s" in {signal.name for signal in shown_signals(graphs_of([entry], FRAMES), FRAMES)}
    assert graphs_of([GraphEntry(title="none", signals=["port_z.x"])], FRAMES, "port_a")[0].title == "port_a.npp-ppp"


def test_a_session_says_its_graphs_and_signals_itself() -> None:
    texts = {f"frames/{one}.yaml": (ROOT / "frames" / f"{one}.yaml").read_text() for one in ("ngu_a", "ngu_b")}
    texts["stations/af_bench_sim.yaml"] = (ROOT / "stations" / "af_bench_sim.yaml").read_text()
    links = {"port_a": "frames/ngu_a.yaml", "port_b": "frames/ngu_b.yaml", "gone": "frames/gone.yaml"}
    manifest = {"links": links, "station": "af_bench_sim", "measurement_link": "port_a"}
    assert len(session_graphs(manifest, texts)) == 3
    signals = session_signals(manifest, texts)
    assert len(signals) == 55
    assert sum(signal.rate_Hz == 100.0 for signal in signals) == 10  # of the ten inputs that are drawn
    del texts["stations/af_bench_sim.yaml"]
    assert session_graphs(manifest, texts)[0].title == "port_a.npp-ppp"
    assert session_graphs({}, {})[0].title == "Temperature"
