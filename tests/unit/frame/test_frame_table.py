"""Raw captures as tables."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from record_sample import frame

from bench.frame.table import decode_file, write_csv
from bench.model.errors import InputError

GOLDEN = Path(__file__).resolve().parents[2] / "golden"


def golden(name: str) -> bytes:
    return bytes.fromhex((GOLDEN / f"{name}.hex").read_text(encoding="ascii"))


def test_counts_and_csv_of_a_capture_longer_than_a_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.frame.table._BLOCK_BYTES", 1000)
    monkeypatch.setattr("bench.frame.table._ROWS_AT_ONCE", 7)
    definition = frame("ngu_a")
    columns = {"counter": np.arange(100) * 2, "npp": 1, "ppp": 2, "af_clock": 3, "master_count": 4, "fg_count": 5}
    rows = definition.encode(columns | {"status": 1 << 12}, 100)
    rows[50, 30] ^= 1
    capture = tmp_path / "capture.bin"
    capture.write_bytes(b"noise" + rows.tobytes() + b"\xeb\x90")
    decoded = decode_file(definition, capture)
    assert decoded.summary() == {
        "frame": "ngu_a", "frame_sha256": definition.sha256, "good": 99, "bytes": 5707, "bad": 1, "lost": 100,
        "duplicate": 0, "suspect": 0, "skipped_bytes": 64, "messages": {"frame": 99},
    }  # fmt: skip
    assert write_csv(decoded, tmp_path / "out.csv") == [tmp_path / "out.csv"]
    with (tmp_path / "out.csv").open(newline="", encoding="utf-8") as stream:
        table = list(csv.DictReader(stream))
    assert len(table) == 99
    assert [int(row["counter"]) for row in table] == [2 * i for i in range(100) if i != 50]
    assert [int(row["offset"]) for row in table[:2]] == [5, 62]
    assert table[98]["npp_10 [pulse]"] == "1"
    assert (table[98]["status.mode"], table[98]["status.calibrating"]) == ("1", "0")


def test_one_csv_per_message_in_physical_units(tmp_path: Path) -> None:
    definition = frame("ngu_b")
    capture = tmp_path / "port_b.bin"
    capture.write_bytes(golden("ngu_b.housekeeping") + golden("ngu_b.answer"))
    for engine in ("numpy", "reference"):
        written = write_csv(decode_file(definition, capture, engine), tmp_path / "b.csv")  # type: ignore[arg-type]
        assert [path.name for path in written] == ["b.housekeeping.csv", "b.answer.csv", "b.command.csv"]
        with written[0].open(newline="", encoding="utf-8") as stream:
            (row,) = csv.DictReader(stream)
        assert float(row["unit_temperature_1 [degC]"]) == pytest.approx(-10.23, abs=1e-12)
        assert float(row["supply_voltage [V]"]) == pytest.approx(28.012, abs=1e-12)
        assert b"NGU SIM-1".hex() in written[1].read_text(encoding="utf-8")
        assert len(written[2].read_text(encoding="utf-8").splitlines()) == 1


def test_floats_are_printed_so_that_they_read_back_exactly(tmp_path: Path) -> None:
    definition = frame("vn100_binary")
    generator = np.random.default_rng(5)
    names = [item.name for item in definition.message().fields if item.name != "header"]
    columns = {name: generator.normal(size=20).astype(np.float32) for name in names}
    capture = tmp_path / "vn.bin"
    capture.write_bytes(definition.encode(columns, 20).tobytes())
    write_csv(decode_file(definition, capture), tmp_path / "vn.csv")
    table = np.loadtxt(tmp_path / "vn.csv", delimiter=",", skiprows=1)
    assert table.shape == (20, 30)
    for index, name in enumerate(names):
        assert (table[:, index + 1].astype(np.float32) == columns[name]).all()


def test_files_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    definition = frame("ngu_a")
    with pytest.raises(InputError) as caught:
        decode_file(definition, tmp_path / "nothing.bin")
    assert caught.value.code == "B-FRAME-030"
    capture = tmp_path / "empty.bin"
    capture.write_bytes(b"")
    decoded = decode_file(definition, capture)
    assert decoded.summary()["good"] == 0
    with pytest.raises(InputError) as caught:
        write_csv(decoded, tmp_path / "no_folder" / "out.csv")
    assert caught.value.code == "B-FRAME-032"
