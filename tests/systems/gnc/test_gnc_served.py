"""The simulated GNC bench as a process of its own: a terminal for its link, a socket for what a person does."""

import binascii
import json
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from one_estimate import value
from rehearsal import bench
from served_bench import CLOCK, Served

pytestmark = pytest.mark.waits

PATIENCE_S = 10.0


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    bench = Served(tmp_path_factory.mktemp("bench") / "sim", "gnc_bench_sim")
    for message in ("VOLT 5", "CURR 0.6", "OUTP ON"):
        bench["supply"].write(message)
    yield bench
    assert bench.end() == 0


def frame(command: int, payload: bytes, sequence: int) -> bytes:
    body = struct.pack("<6BH", 1, 0x10, 0x01, sequence, 0x01, command, len(payload)) + payload
    return b"\xeb\x90" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def serial_number(served: Served, sequence: int) -> str:
    """Ask the module who it is until it has booted."""
    head = b"\xeb\x90\x01\x01\x10" + bytes([sequence])
    end_ns = CLOCK.now_ns() + round(PATIENCE_S * 1e9)
    received = b""
    with serial.Serial(str(served.folder / "rs422"), timeout=0.2, exclusive=True) as port:
        while CLOCK.now_ns() < end_ns:
            port.write(frame(0x01, b"", sequence))
            received += port.read(40)
            at = received.find(head)
            if at >= 0 and len(received) >= at + 40:
                return received[at + 24 : at + 36].decode().strip()
    raise AssertionError(f"no answer: {received!r}")


def test_a_module_answers_at_its_terminal_and_another_one_after_a_change(served: Served) -> None:
    assert serial_number(served, 1) == "GNC-01"
    served.fault("operate", "unit", "GNC-05")
    assert serial_number(served, 2) == "GNC-05"
    assert served.state()["unit"]["powered"]
    for what, to, code in (("chamber", "1", "B-SIM-018"), ("dip_switch", "7", "B-SIM-019")):  # what nobody can do
        with pytest.raises(AssertionError, match=code):
            served.fault("operate", what, to)


PROMPTS = """\
sequence: prompts
station: gnc_bench_sim
frame: {rs422: gnc_422}
analysis: gnc_unit_test
uut: {model: GNC, serial: BATCH-1}
prepare:
  - supply.configure: {voltage: 5 V, current_limit: 0.6 A, over_voltage: 5.6 V}
steps:
  - for: unit
    in: [GNC-08, GNC-09]
    do:
      - prompt: {text: "Put unit {unit} into the socket.", sets: {unit: "{unit}"}}
      - supply.output_on
      - settle: 2 s
      - test: {item: identify, command: identify}
      - prompt: {text: "DIP switch 3 on, all others off.", sets: {dip_switch: 3}}
      - test: {item: ad, command: ad, arguments: {dip: 3}}
      - supply.output_off
finally:
  - supply.output_off
"""


def test_a_run_does_on_a_served_bench_what_its_prompts_set(served: Served, tmp_path: Path) -> None:
    """Who is in the socket and which switch is on are seen from the answers, not from what the run believes."""
    sequence = tmp_path / "prompts.yaml"
    sequence.write_text(PROMPTS)
    station = str(served.folder / "station.yaml")
    done = bench(
        "run", str(sequence), "--station", station, "--clock", "wall", "--out", str(tmp_path / "out"), "--json"
    )
    assert done.stdout, done.stderr
    results = json.loads(done.stdout)
    units = ("GNC-08", "GNC-09")
    assert [value(results, "identify_wrong", unit=unit) for unit in units] == [0.0, 0.0]
    volts = [value(results, "ad_volts", unit=unit, source="1.2 V") for unit in units]
    assert volts == pytest.approx([1.2, 1.2], rel=0.05)
