"""Raw captures as tables."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_sample import captured, frame

from bench.commands.frame.decode import decode
from bench.frame import FrameDefinition, Tables, decode_capture
from bench.model.errors import InputError

GOLDEN = Path(__file__).resolve().parents[2] / "golden"


def golden(name: str) -> bytes:
    return bytes.fromhex((GOLDEN / f"{name}.hex").read_text(encoding="ascii"))


def tabulated(definition: FrameDefinition, capture: Path, out: Path, engine: Any = None) -> list[Path]:
    with Tables(definition, out) as tables, capture.open("rb") as stream:
        decode_capture(definition, stream, tables.write, engine)
    return list(tables.paths.values())


def test_counts_and_csv_of_a_capture_longer_than_a_block(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.frame.capture._BLOCK_BYTES", 1000)
    monkeypatch.setattr("bench.frame.table._ROWS_AT_ONCE", 7)
    definition = frame("ngu_a")
    columns = {"counter": np.arange(100) * 2, "npp": 1, "ppp": 2, "af_clock": 3, "master_count": 4, "fg_count": 5}
    rows = definition.encode(columns | {"status": 1 << 12}, 100)
    rows[50, 30] ^= 1
    capture = tmp_path / "capture.bin"
    capture.write_bytes(b"noise" + rows.tobytes() + b"\xeb\x90")
    assert captured(definition, capture)[0].summary() == {
        "frame": "ngu_a", "frame_sha256": definition.sha256, "check": "crc-16/ibm-3740", "good": 99, "bytes": 5707,
        "bad": 1, "lost": 100, "duplicate": 0, "suspect": 0, "skipped_bytes": 64, "other": 0,
        "messages": {"frame": 99}, "cut_off": True, "bad_because": [{
            "cause": "check", "number": 1, "offset": 5 + 50 * 57,
            "text": "fails its check: crc-16/ibm-3740 over bytes 2 to 54 is 0xd68a, the frame holds 0x933e"}],
    }  # fmt: skip
    assert tabulated(definition, capture, tmp_path / "out.csv") == [tmp_path / "out.csv"]
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
        written = tabulated(definition, capture, tmp_path / "b.csv", engine)
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
    tabulated(definition, capture, tmp_path / "vn.csv")
    table = np.loadtxt(tmp_path / "vn.csv", delimiter=",", skiprows=1)
    assert table.shape == (20, 30)
    for index, name in enumerate(names):
        assert (table[:, index + 1].astype(np.float32) == columns[name]).all()


@pytest.mark.parametrize("name", ["ngu_a", "ngu_b", "vn100_binary"])
def test_parquet_has_the_columns_and_values_of_the_csv(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    monkeypatch.setattr("bench.frame.capture._BLOCK_BYTES", 500)
    capture = tmp_path / "capture.bin"
    of_one = [path.read_text(encoding="ascii") for path in sorted(GOLDEN.glob(f"{name}*.hex"))]
    capture.write_bytes(b"".join(map(bytes.fromhex, of_one)) * 30)
    tables = (
        tabulated(frame(name), capture, tmp_path / "t.csv"),
        tabulated(frame(name), capture, tmp_path / "t.parquet"),
    )
    rows = 0
    for csv_path, parquet_path in zip(*tables, strict=True):
        found = parquet.read_table(parquet_path)
        with csv_path.open(newline="", encoding="utf-8") as stream:
            head, *lines = csv.reader(stream)
        assert found.column_names == head
        assert found.num_rows == len(lines)
        for title, texts in zip(head, zip(*lines, strict=True), strict=True) if lines else ():
            values = found[title].to_pylist()
            assert [value.hex() if isinstance(value, bytes) else float(value) for value in values] == [
                text
                if isinstance(value, bytes)
                else float(np.float32(text))
                if found[title].type == "float"
                else float(text)
                for text, value in zip(texts, values, strict=True)
            ]
        rows += len(lines)
    assert rows >= 30
    assert not list(tmp_path.glob("*.part"))


def test_a_table_that_is_not_finished_leaves_nothing(tmp_path: Path) -> None:
    definition = frame("ngu_a")
    capture = tmp_path / "capture.bin"
    capture.write_bytes(golden("ngu_a") * 3)

    def broken(tables: Tables) -> None:
        with tables, capture.open("rb") as stream:
            decode_capture(definition, stream, tables.write)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken(Tables(definition, tmp_path / "out.csv"))
    assert [path.name for path in tmp_path.iterdir()] == ["capture.bin"]


def test_a_device_stays_one_and_a_link_leads_to_the_table(tmp_path: Path) -> None:
    capture, device, link = tmp_path / "capture.bin", tmp_path / "device", tmp_path / "link.csv"
    capture.write_bytes(golden("ngu_a"))
    device.symlink_to("/dev/null")
    link.symlink_to(tmp_path / "table.csv")
    for out in (device, link):
        tabulated(frame("ngu_a"), capture, out)
        assert out.is_symlink()
    assert device.is_char_device()
    assert len((tmp_path / "table.csv").read_text(encoding="utf-8").splitlines()) == 2
    assert not list(tmp_path.glob("*.part"))


def test_a_table_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    definition = frame("ngu_a")
    capture = tmp_path / "capture.bin"
    capture.write_bytes(golden("ngu_a"))
    for name in ("out.csv", "out.parquet"):
        with pytest.raises(InputError) as caught:
            tabulated(definition, capture, tmp_path / "no_folder" / name)
        assert caught.value.code == "B-FRAME-032"
    monkeypatch.setattr("bench.frame.table.find_spec", lambda name: None)
    with pytest.raises(InputError) as caught:
        Tables(definition, tmp_path / "out.parquet")
    assert caught.value.code == "B-FRAME-033"


@pytest.mark.parametrize(
    ("capture", "said"),
    [
        (b"", "the capture is empty"),
        (b"noise", "the sync bytes eb 90 begin no frame of a possible length in 5 bytes"),
        (golden("ngu_a")[:-3], "the capture ends inside the first frame that has begun"),
        (golden("ngu_a")[:-1] + b"?", "1 places look like the beginning of a frame"),
    ],
)
def test_a_capture_without_a_good_frame_says_why(
    capture: bytes, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "capture.bin").write_bytes(capture)
    assert decode("ngu_a", tmp_path / "capture.bin", None, None, False) == 1
    assert f"nothing good: {said}" in capsys.readouterr().err


def test_standard_input_is_a_capture_too(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    stream = io.TextIOWrapper(io.BytesIO(golden("ngu_a") * 3 + golden("ngu_a")[:20]))
    monkeypatch.setattr("sys.stdin", stream)
    assert decode("ngu_a", Path("-"), None, None, False) == 0
    said = capsys.readouterr().out
    assert "standard input: ngu_a" in said
    assert "good           3" in said
    assert "cut off in its last frame" in said


def test_a_capture_that_cannot_be_read_and_a_wrong_suffix(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        decode("ngu_a", tmp_path / "nothing.bin", None, None, False)
    assert caught.value.code == "B-FRAME-030"
    with pytest.raises(InputError) as caught:
        decode("ngu_a", tmp_path / "nothing.bin", None, tmp_path / "out.csv", False)
    assert caught.value.code == "B-FRAME-032"
