"""A log becomes a session: its bytes as they are, at the times of its rows, and all of it again from the folder."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from imported_logs import LOG, SHORT

from bench.commands import import_log
from bench.commands.import_log import import_log as import_file
from bench.model.errors import InputError, SessionDamaged
from bench.record import SessionReader, SessionWriter
from bench.replay import replay_rows
from bench.replay.series import replay_series, survey


def imported(tmp_path: Path, mapping: str, log: bytes) -> Path:
    (tmp_path / "m.yaml").write_text(mapping)
    (tmp_path / "log.csv").write_bytes(log)
    assert import_file(tmp_path / "m.yaml", tmp_path / "log.csv", tmp_path / "out") == 0
    return next((tmp_path / "out").iterdir())


def test_the_bytes_are_those_of_the_file_at_the_times_of_its_rows(tmp_path: Path) -> None:
    content = (LOG + "\n2024-01-01T00:00:30,20,\r\n2024-01-01T00:01:00,21,2").encode()
    folder = imported(tmp_path, SHORT.replace("uut:", "bad_rows: 50 %\nuut:"), content)
    assert folder.name == "20240101T000000Z_any_log_S-1"
    reader = SessionReader(folder)
    lines = [message for message in reader.messages() if message.topic == "/link/log/rx"]
    assert b"".join(one.payload for one in lines) == content
    assert [one.t_ns // 10**9 for one in lines] == [0, 0, 10, 10, 10, 60]
    clocks = [message.document() for message in reader.messages() if message.topic == "/clock"]
    assert [(one["t_mono_ns"] // 10**9, one["t_utc_ns"] // 10**9) for one in clocks] == [
        (0, 1704067200),
        (60, 1704067260),
    ]
    assert (reader.damage, reader.unfinished) == ([], [])
    assert reader.manifest["simulated"] is False
    assert reader.manifest["kind"] == "import"
    assert reader.manifest["log"]["sha256"] == hashlib.sha256(content).hexdigest()
    assert reader.manifest["log"] | {"rows": 3, "bad_rows": 1, "overload_rows": 0} == reader.manifest["log"]


def test_the_columns_come_back_from_the_session_alone(tmp_path: Path) -> None:
    folder = imported(
        tmp_path,
        SHORT.replace("uut:", "overload: {values: [OL]}\nuut:"),
        (LOG + "2024-01-01T00:00:20,20.7,OL\n").encode(),
    )
    (tmp_path / "log.csv").unlink()
    (tmp_path / "m.yaml").unlink()
    found = replay_series(folder)
    assert found.columns["t_s"].tolist() == [0.0, 10.0, 20.0]
    assert found.columns["sensor"].tolist() == [20.5, 20.6, 20.7]
    np.testing.assert_allclose(found.columns["voltage"], [1.0, 1.001, np.nan], rtol=1e-15)
    said = "1 of 3 rows of the log have a cell that is empty or that the mapping calls an overload (voltage 1)."
    assert found.notes == (said,)
    replayed = replay_rows(folder)
    assert (replayed.rows, replayed.totals["frames"], replayed.notes) == ((), 0, ())


def test_an_unknown_analysis_is_refused_with_its_place(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"B-FIT-011: .*m.yaml:2:1: unknown analysis 'temperature_rampe'"):
        imported(tmp_path, SHORT.replace("uut:", "analysis: temperature_rampe\nuut:", 1), LOG.encode())
    assert not (tmp_path / "out").exists()


def test_a_log_that_grows_meanwhile_is_taken_as_it_was_surveyed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def surveyed_then_grown(lines: object, mapping: object, name: str) -> object:
        found = survey(lines, mapping, name)  # type: ignore[arg-type]
        with Path(name).open("ab") as stream:
            stream.write(b"2024-01-01T00:00:05,goes,back\n")
        return found

    monkeypatch.setattr(import_log, "survey", surveyed_then_grown)
    folder = imported(tmp_path, SHORT, LOG.encode())
    lines = SessionReader(folder).messages(frozenset({"/link/log/rx"}))
    assert b"".join(one.payload for one in lines) == LOG.encode()


def test_a_second_import_gets_a_folder_of_its_own_with_the_same_bytes(tmp_path: Path) -> None:
    first = imported(tmp_path, SHORT, LOG.encode())
    assert import_file(tmp_path / "m.yaml", tmp_path / "log.csv", tmp_path / "out") == 0
    second = first.with_name(first.name + "-2")
    assert SessionReader(first).sha256 == SessionReader(second).sha256


def test_a_long_log_is_cut_into_segments(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(import_log, "ROTATE_BYTES", 20_000)
    rows = [f"2024-01-{1 + at // 24:02d}T{at % 24:02d}:00:00,20,{'1' * 200}\n" for at in range(240)]
    folder = imported(tmp_path, SHORT, ("time,T,U\n" + "".join(rows)).encode())
    assert len(list(folder.glob("*.mcap"))) > 1
    assert SessionReader(folder).damage == []
    assert replay_series(folder).columns["t_s"].size == 240


def test_a_session_without_its_mapping(tmp_path: Path) -> None:
    writer = SessionWriter.create(tmp_path / "s", {"kind": "import", "schema": 1}, {}, t_mono_ns=0)
    writer.raw("log", "rx", 0, LOG.encode())
    writer.close("done")
    with pytest.raises(SessionDamaged, match="B-IMP-007"):
        replay_series(tmp_path / "s")


def test_bytes_cut_anywhere_by_another_writer_and_a_changed_log_is_told(tmp_path: Path) -> None:
    manifest = {"kind": "import", "schema": 1, "log": {"file": "x.csv", "sha256": "0" * 64}}
    writer = SessionWriter.create(tmp_path / "s", manifest, {"mapping.yaml": SHORT}, t_mono_ns=0)
    for at in range(0, len(LOG), 7):
        writer.raw("log", "rx", at, LOG[at : at + 7].encode())
    writer.close("done")
    found = replay_series(tmp_path / "s")
    assert found.columns["sensor"].tolist() == [20.5, 20.6]
    assert "is not the file that was imported" in found.notes[0]
