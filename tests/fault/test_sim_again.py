"""``bench sim`` begun again in its folder: the same ports, so that a session begun on it can be resumed."""

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from rehearsal import bench
from served_bench import CLOCK, Served

from bench.model.errors import ExitStatus
from bench.model.shipped import find_shipped
from bench.plan import load_station
from sim_instruments.served.process import ServedBench

pytestmark = pytest.mark.waits

SOME_SECONDS = """\
sequence: some_seconds
title: The supply is on, and the unit is recorded for some seconds
station: af_bench_sim
frame: {port_a: ngu_a, port_b: ngu_b}
unit_commands:
  start_stream: {code: 2, payload: "64"}
timeline:
  - {at: "00:00:00", call: {supply.configure: {voltage: 18 V, current_limit: 2 A, over_voltage: 21 V}}}
  - {at: "00:00:01", call: supply.output_on}
  - {at: "00:00:03", unit: {port_b: start_stream}}
  - {at: "00:00:04", record: {seconds: 1 s, label: first}}
  - {at: "00:00:06", record: {seconds: 1 s, label: second}}
finally:
  - supply.output_off
"""


@pytest.mark.slow
def test_a_session_goes_on_when_its_simulator_was_killed_and_begun_again(tmp_path: Path) -> None:
    folder, sequence = tmp_path / "sim", tmp_path / "some_seconds.yaml"
    sequence.write_text(SOME_SECONDS)
    first = Served(folder, "af_bench_sim")
    words = ["run", str(sequence), "--station", str(folder / "station.yaml"), "--clock", "wall"]
    with (tmp_path / "said").open("w") as said:
        command = [sys.executable, "-m", "bench", *words, "--out", str(tmp_path / "out")]
        run = subprocess.Popen(command, stdout=said, stderr=said, stdin=subprocess.DEVNULL)
    first.until(lambda state: state["instruments"]["supply"]["on"], "the supply is on")
    run.terminate()
    assert run.wait(60) == ExitStatus.SAFE_BY_OPERATOR, (tmp_path / "said").read_text()
    resources = [entry.resource for entry in first.station.instruments.values()]
    ports = first.said
    assert first.end(signal.SIGKILL) == -signal.SIGKILL
    again = Served(folder, "af_bench_sim")
    assert [entry.resource for entry in again.station.instruments.values()] == resources
    assert again.said == ports, "raw sockets and terminals too, and nothing is told"
    (session,) = (tmp_path / "out").iterdir()
    done = bench("resume", str(session))
    assert again.end() == 0
    assert done.returncode == 0, done.stderr
    assert "2 records" in done.stdout


def test_a_port_that_somebody_else_has_is_told_and_another_one_taken(tmp_path: Path) -> None:
    folder = tmp_path / "sim"
    first = Served(folder, "af_bench_sim")
    for number in (signal.SIGSTOP, signal.SIGCONT):  # it stands still for a while, and goes on
        first.process.send_signal(number)
        CLOCK.sleep(1.0)
    assert "supply" in first.state()["instruments"]
    assert first.end() == 0
    ports = json.loads((folder / "ports.json").read_text())
    with socket.create_server(("127.0.0.1", ports["supply"])):
        again = Served(folder, "af_bench_sim")
        now = json.loads((folder / "ports.json").read_text())
        assert again.end() == 0
    assert {name for name, port in ports.items() if now[name] != port} == {"supply"}
    (told,) = (line for line in again.said if "is taken" in line)
    assert told.startswith(f"supply: port {ports['supply']} is taken, another one is used")


@pytest.mark.parametrize("text", ["", "[1]", '{"hislip": "x"}', '{"hislip": 70000}', '{"hislip": -1}', "\xff"])
def test_ports_that_cannot_be_read_are_forgotten(tmp_path: Path, text: str) -> None:
    (tmp_path / "ports.json").write_text(text, encoding="latin-1")
    served = ServedBench(
        "af_converter", load_station(find_shipped("stations", "af_bench_sim")).wiring(), {}, seed=1, rate=1.0,
        folder=tmp_path,
    )  # fmt: skip
    try:
        assert json.loads((tmp_path / "ports.json").read_text())["hislip"] > 0
    finally:
        served.close()
