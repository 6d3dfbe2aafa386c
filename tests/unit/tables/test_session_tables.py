"""Tables of a session: the numbers that its readers give, on one axis, as xarray too; and the live view of Jupyter."""

import json
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray
from matplotlib.figure import Figure
from record_sample import AWAY_S, FRAMES, NS, counted, frame, write_resumed
from top_sample import NAMES, FeedStandIn

import bench
from bench.frame import LinkDecoder
from bench.model.clock import WallClock
from bench.model.errors import BenchError, InputError
from bench.record import SessionReader, SessionWriter
from bench.record.journal import JOURNAL_NAME
from bench.replay import decoded_frames, read_course, replay_rows, replay_series
from bench.tables import Session
from bench.tables.plain import arrays_of, words_of

GOLDEN = sorted((Path(__file__).resolve().parents[2] / "golden" / "sessions").glob("*/*"))
START = pd.Timestamp("2000-01-01", tz="UTC")


@pytest.fixture(scope="module")
def resumed(tmp_path_factory: pytest.TempPathFactory) -> Session:
    folder = tmp_path_factory.mktemp("tables") / "resumed"
    write_resumed(folder)
    return Session(folder)


def refused(code: str, ask: Any) -> str:
    with pytest.raises(BenchError) as caught:
        ask()
    assert caught.value.code == code
    return str(caught.value)


def test_nothing_is_read_before_it_is_asked_for(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bench.tables.session.replay_rows", lambda folder: pytest.fail("decoded"))
    monkeypatch.setattr("bench.tables.session.read_course", lambda folder: pytest.fail("read"))
    session = Session(str(golden))
    assert session.manifest["sequence"] == "golden"
    assert session.links == ("port_a", "port_b")
    assert session.messages("port_b") == ("housekeeping", "answer", "command")
    assert "plan.json" in session.texts
    assert str(golden) in repr(session)


@pytest.mark.parametrize("folder", GOLDEN, ids=lambda path: path.name)
def test_sessions_of_every_system_have_their_tables(folder: Path) -> None:
    session, replayed = Session(folder), replay_rows(folder)
    assert len(session.records) == len(replayed.rows)
    assert len(session.events) == len(replayed.events)
    for link, counts in replayed.counts.items():
        assert sum(len(session.frames(link, message)) for message in session.messages(link)) == counts.frames
    assert not session.damaged
    assert pickle.loads(pickle.dumps(session)).links == session.links
    assert bool(len(session.log)) == ("log" in session.manifest)


def test_an_imported_log_is_a_table_in_base_units() -> None:
    (folder,) = [folder for folder in GOLDEN if "MAGNETOMETER-LOG" in folder.name]
    log, series = Session(folder).log, replay_series(folder).columns
    assert log.columns.tolist() == ["t_mono_ns", *(f"mag_{axis}_gauss" for axis in "xyz")]
    np.testing.assert_array_equal(log["mag_y_gauss"], series["mag_y_gauss"])
    assert (log.index[1] - log.index[0], log.attrs["units"]["mag_z_gauss"]) == (pd.Timedelta("100ms"), "gauss")
    dataset = bench.to_xarray(Session(folder).estimates)  # of soft iron by "row" and "column"
    assert dataset["condition_row"].values[-1] == "z"


def test_records_are_those_of_the_replay(golden: Path) -> None:
    records, replayed = Session(golden).records, replay_rows(golden)
    assert records.attrs["simulated"] is True
    assert records.attrs["session"] == replayed.manifest["session"]
    for (start, row), record in zip(records.iterrows(), replayed.rows, strict=True):
        window = record.window
        assert (row["number"], row["link"], row["first_counter"]) == (window.number, window.link, window.first_counter)
        assert (start.value, row["stop"].value) == tuple(
            t_ns + (replayed.utc_offset_ns or 0) for t_ns in (window.t_start_ns, window.t_end_ns)
        )
        assert {name: row[name] for name in window.conditions if name != "channel"} == {
            name: value for name, value in window.conditions.items() if name != "channel"
        }
        assert [row[f"sum_npp_{k}"] for k in range(1, 11)] == record.sums["npp"].tolist()
        assert row["mean_unit_temperature_degC"] == record.context["unit_temperature_degC"]
    units = records.attrs["units"]
    assert (units["current_A"], units["mean_unit_temperature_degC"], units["sum_npp_1"]) == ("A", "degC", "pulse")
    assert records["valid"].all()
    assert (records["flags"] == "").all()


def test_a_resumed_session_has_one_axis(resumed: Session) -> None:
    later = START + pd.Timedelta(seconds=AWAY_S + 5)
    assert resumed.records.index.tolist() == [START + pd.Timedelta("500ms"), later + pd.Timedelta("500ms")]
    assert resumed.records["condition_frames"].tolist() == ["a word", "a word"]  # "frames" is a count
    assert resumed.records["sum_ppp_1"].tolist() == [sum(k % 100 for k in range(51, 151))] * 2
    assert resumed.events["kind"].tolist().count("resume") == 1
    assert resumed.events.index[resumed.events["kind"] == "resume"].tolist() == [later]
    frames = resumed.frames("port_a")
    assert len(frames) == 2 * FRAMES
    assert frames.index.is_monotonic_increasing
    assert (frames.index[0], frames.index[-1]) == (START + pd.Timedelta("10ms"), later + pd.Timedelta("2500ms"))
    assert resumed.utc_offset_ns == START.value


@pytest.mark.parametrize("away_s", [0.0, 3.0, -3600.0])
def test_frames_and_records_agree_whatever_utc_does(tmp_path: Path, away_s: float) -> None:
    write_resumed(tmp_path / "stepped", away_s)
    session = Session(tmp_path / "stepped")
    assert session.frames("port_a").index.is_monotonic_increasing
    for start, record in session.records.iterrows():
        frames = session.frames("port_a", start=start, stop=record["stop"], columns=["counter"])
        assert frames["counter"].tolist() == list(range(51, 151))


def test_readings_have_numbers_conditions_and_what_is_absent(resumed: Session) -> None:
    readings = resumed.readings
    assert readings["role"].tolist() == ["dmm", "lock_in_1", "dmm"] * 2
    assert readings["value"].dtype == np.float64
    np.testing.assert_array_equal(readings["value"], [0.01, np.nan, np.nan, 0.02, np.nan, np.nan])
    assert readings["x_V"].dropna().tolist() == [0.5, 0.5]
    assert readings["overload"].isna().tolist() == [True, False, True] * 2
    assert readings["code"].dropna().tolist() == ["B-X", "B-X"]
    assert readings.attrs["units"] == {"t_mono_ns": "ns", "x_V": "V", "range_A": "A"}


def test_a_reading_has_the_unit_that_its_driver_declares(resumed: Session) -> None:
    (folder,) = [folder for folder in GOLDEN if "gnc_unit_test" in folder.name]
    readings = Session(folder).readings
    units = readings.drop_duplicates(["role", "name"]).set_index(["role", "name"])["unit"].to_dict()
    assert units == {
        ("supply", "measure_voltage"): "V", ("supply", "measure_current"): "A", ("rail_dmm", "measure_voltage"): "V",
    }  # fmt: skip
    (folder,) = [folder for folder in GOLDEN if "golden_fog" in folder.name]
    assert Session(folder).readings["unit"].isna().all()  # several numbers, each with its unit in the name
    assert resumed.readings["unit"].isna().all()  # its manifest names no drivers


def test_events_are_those_of_the_session(golden: Path) -> None:
    events = Session(golden).events
    recorded = list(SessionReader(golden).events())
    assert events["kind"].tolist() == [kind for kind, _, _ in recorded]
    assert events["t_mono_ns"].tolist() == [t_ns for _, t_ns, _ in recorded]
    assert events["fields"].tolist() == [fields for _, _, fields in recorded]


def test_a_session_without_utc_counts_from_1970(tmp_path: Path) -> None:
    texts = {"frames/ngu_a.yaml": "", "plan.json": "[]"}
    writer = SessionWriter.create(tmp_path / "dark", {"session": "dark", "links": {}}, texts, t_mono_ns=0)
    writer.event("phase", 3 * NS, {"name": "campaign", "t_start_ns": 0})
    writer.close("done")
    session = Session(tmp_path / "dark")
    assert session.events.index[0] == pd.Timestamp(3, unit="s", tz="UTC")
    assert session.links == ()
    assert len(session.records) == 0
    assert len(session.readings) == 0


def test_frames_are_what_a_decoder_gives(golden: Path) -> None:
    session = Session(golden)
    decoder = LinkDecoder(frame("ngu_b"))
    for message in SessionReader(golden).messages(frozenset({"/link/port_b/rx"})):
        decoder.push(message.t_ns, message.payload)
    batch = decoder.finish().messages["housekeeping"]
    table = session.frames("port_b")
    assert table.columns[0] == "t_mono_ns"
    np.testing.assert_array_equal(table[[f"rails_{k}" for k in (1, 2, 3)]], batch.scaled("rails"))
    np.testing.assert_array_equal(table["status.streaming"], batch.raw("status.streaming"))
    assert table.attrs["units"]["rails_1"] == "V"
    assert table.attrs["units"]["unit_temperature_4"] == "degC"


def test_frames_come_in_blocks_of_bounded_size(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = Session(golden)
    whole = session.frames("port_a")
    monkeypatch.setattr("bench.replay.course.BLOCK_BYTES", 20_000)
    blocks = [block for name, block in session.frame_blocks("port_a") if name == "frame"]
    assert len(blocks) > 5
    assert max(map(len, blocks)) < 2000
    pd.testing.assert_frame_equal(pd.concat(blocks), whole)


def test_a_window_and_some_columns(resumed: Session) -> None:
    start, stop = resumed.records.index[1], resumed.records["stop"].iloc[1]
    table = resumed.frames("port_a", start=start, stop=stop, columns=["counter", "ppp", "npp_3"])
    assert table.columns.tolist() == ["t_mono_ns", "counter", "npp_3", *(f"ppp_{k}" for k in range(1, 11))]
    assert table["counter"].tolist() == list(range(51, 151))
    assert len(resumed.frames("port_a", stop="2000-01-01T00:00:01")) == 100
    assert len(resumed.frames("port_a", start="2000-01-01T00:01", stop="2000-01-01T00:02")) == 0


def test_only_chunks_that_touch_the_window_are_read(resumed: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    definition, course = frame("ngu_a"), read_course(resumed.folder)
    seen = decoded_frames(
        resumed.folder, "port_a", definition, course, (START.value / NS + 1004, START.value / NS + 1100)
    )
    assert sum(len(frames.batch) for frames in seen) == FRAMES


def test_what_a_frame_does_not_hold_is_absent(resumed: Session) -> None:
    table = resumed.frames("sensors", "measurements")
    assert table["value_1"].tolist() == [-123, -123]
    assert table["value_3"].isna().all()
    assert str(table["value_3"].dtype) == "Int64"
    pulses = resumed.frames("port_a")
    assert (pulses["npp_1"] - pulses["ppp_1"]).min() < 0
    assert table["calibration_tick"].tolist() == [120.0, 120.0]
    assert "value_5" not in table


def test_a_message_that_never_came_has_its_columns(golden: Path) -> None:
    table = Session(golden).frames("port_b", "command")
    assert len(table) == 0
    assert len(table.columns) > 1
    pd.testing.assert_index_equal(table.columns, Session(golden).empty_frames("port_b", "command").columns)


def test_raw_bytes_are_read_across_segments(tmp_path: Path) -> None:
    """A frame that begins in one segment and ends in the next one is not lost."""
    text = frame("ngu_a").text
    manifest = {"session": "long", "links": {"port_a": "frames/ngu_a.yaml"}, "measurement_link": "port_a"}
    writer = SessionWriter.create(tmp_path / "long", manifest, {"frames/ngu_a.yaml": text}, t_mono_ns=0)
    raw = counted(1, 400)
    for k, begin in enumerate(range(0, len(raw), 1001)):
        t_ns = (k + 1) * 600 * NS
        writer.raw("port_a", "rx", t_ns, raw[begin : begin + 1001])
        writer.tick(t_ns)
    writer.close("done")
    assert len(list((tmp_path / "long").glob("*.mcap"))) > 1
    assert Session(tmp_path / "long").frames("port_a")["counter"].tolist() == list(range(1, 401))


def test_estimates_are_those_of_the_results(golden: Path) -> None:
    session = Session(golden)
    stored = json.loads((golden / "results.json").read_text())["estimates"]
    table = session.estimates
    assert session.results["estimates"] == stored
    assert table["value"].tolist() == [estimate["value"] for estimate in stored]
    assert table["unit"].tolist() == [estimate["unit"] for estimate in stored]
    channels = [estimate["conditions"].get("channel") for estimate in stored]
    assert table["channel"].astype(object).where(table["channel"].notna(), None).tolist() == channels
    assert set(table["quality"]) == {"sound"}
    assert table.attrs["units"]["temperature_degC"] == "degC"


def test_what_is_not_there_is_one_clear_error(resumed: Session, tmp_path: Path) -> None:
    refused("B-REC-010", lambda: Session(tmp_path / "nothing"))
    assert "port_a, sensors" in refused("B-TAB-002", lambda: resumed.frames("port_z"))
    refused("B-TAB-002", lambda: resumed.messages("port_z"))
    assert "measurements, attitude" in refused("B-TAB-003", lambda: resumed.frames("sensors"))
    refused("B-TAB-003", lambda: resumed.frames("sensors", "nonsense"))
    refused("B-TAB-004", lambda: resumed.frames("port_a", start="yesterday noon"))
    assert "npp_1" in refused("B-TAB-005", lambda: resumed.frames("port_a", columns=["npp", "npp_11"]))
    assert "bench.fit" in refused("B-TAB-006", lambda: resumed.estimates)


def test_results_that_are_none(golden: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    folder.mkdir()
    shutil.copy(golden / "session.0001.mcap", folder)
    for text, code in (("{", "B-TAB-006"), ('{"schema": 7}', "B-FIT-010")):
        (folder / "results.json").write_text(text)
        refused(code, lambda: Session(folder).results)


def test_without_pandas_or_xarray_there_are_no_tables(golden: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    records = Session(golden).records
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match=r"B-TAB-001: .*pip install 'inertial-bench\[xarray\]'"):
        bench.to_xarray(records)
    monkeypatch.setitem(sys.modules, "pandas", None)
    session = Session(golden)
    assert session.results["campaign"] == "scale_factor"
    for ask in (lambda: session.events, lambda: session.records, lambda: session.frames("port_a")):
        with pytest.raises(InputError, match=r"B-TAB-001: .*pip install 'inertial-bench\[python\]'"):
            ask()


def test_damage_is_told(resumed: Session, tmp_path: Path) -> None:
    folder = tmp_path / "damaged"
    shutil.copytree(resumed.folder, folder)
    path = folder / "session.0001.mcap"
    raw = bytearray(path.read_bytes())
    raw[len(raw) * 2 // 3] ^= 0xFF
    path.write_bytes(raw)
    session = Session(folder)
    assert session.damaged
    assert "damaged: session.0001.mcap" in session.remarks[0]


@pytest.fixture(scope="module")
def tables(golden: Path, resumed: Session) -> dict[str, pd.DataFrame]:
    """Return every kind of table: of a rehearsed session, and one with groups that are not full."""
    session = Session(golden)
    return {
        "events": session.events, "readings": resumed.readings, "records": session.records,
        "estimates": session.estimates, "port_b": session.frames("port_b"),
        "sensors": resumed.frames("sensors", "measurements"), "none": session.frames("port_b", "command"),
    }  # fmt: skip


TABLES = ("events", "readings", "records", "estimates", "port_b", "sensors", "none")


@pytest.mark.parametrize("name", TABLES)
def test_a_dataset_has_the_numbers_and_units_of_its_table(
    tables: dict[str, pd.DataFrame], name: str, tmp_path: Path
) -> None:
    table = tables[name]
    bench.to_xarray(table).to_netcdf(tmp_path / "table.nc")
    dataset = xarray.load_dataset(tmp_path / "table.nc")
    names = words_of(table)
    assert set(map(str, dataset.data_vars)) == set(names.values())
    for column, variable in names.items():
        values, cells = dataset[variable].values, table[column]
        assert dataset[variable].attrs.get("units") == table.attrs["units"].get(column)
        assert dataset[variable].attrs["long_name"] not in ("", column if "_" in column else "")
        if pd.api.types.is_numeric_dtype(cells.dtype):
            np.testing.assert_array_equal(values.astype(float), cells.to_numpy(float, na_value=np.nan))
    assert dataset.attrs == {"session": table.attrs["session"], "simulated": 1}
    if table.index.name == "time":
        assert dataset.sizes == {"time": len(table)}
        pd.testing.assert_index_equal(
            dataset.indexes["time"].tz_localize("UTC"), table.index, exact=False, check_names=False
        )
        assert dataset["time"].attrs["standard_name"] == "time"
    else:
        assert dataset.sizes == {"row": len(table)}


def test_names_that_would_be_alike_are_told_apart() -> None:
    index = pd.DatetimeIndex(["2000-01-01"], name="time", tz="UTC")
    long = "x" * 70
    table = pd.DataFrame({"a.b": [1.0], "a_b": [2.0], "time": [3.0], f"{long}1": [4.0], f"{long}2": [5.0]}, index=index)
    table.attrs["units"] = {"a_b": "V", "time": "s"}
    assert list(words_of(table).values()) == ["a_b", "a_b_2", "time_2", "x" * 63, f"{'x' * 61}_2"]
    arrays: dict[str, Any] = arrays_of(table)
    assert (arrays["time"][0], arrays["time_2"][0]) == (946_684_800 * 10**9, 3.0)
    dataset = bench.to_xarray(table)
    assert (dataset["a_b_2"].attrs["units"], dataset["time_2"].attrs["units"]) == ("V", "s")


SIGNAL = NAMES[2]
HOLDER = """
import sys
from pathlib import Path
from bench.record.journal import _locked
descriptor = _locked(Path(sys.argv[1]))
print(flush=True)
sys.stdin.read()
"""


class Notebook:
    """What Jupyter would show: each figure, and how its picture came to the page."""

    def __init__(self) -> None:
        self.figures: list[Figure] = []
        self.shown: list[tuple[str, bytes]] = []

    def DisplayHandle(self) -> Any:
        return SimpleNamespace(
            display=lambda image: self.shown.append(("display", image)),
            update=lambda image: self.shown.append(("update", image)),
        )

    def Image(self, data: bytes) -> bytes:
        assert data.startswith(b"\x89PNG\r\n\x1a\n")
        return data


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> Notebook:
    made = Notebook()
    monkeypatch.setitem(sys.modules, "IPython.display", made)
    plain = Figure.savefig

    def kept(figure: Figure, *words: Any, **options: Any) -> None:
        made.figures.append(figure)
        plain(figure, *words, **options)

    monkeypatch.setattr(Figure, "savefig", kept)
    return made


@pytest.fixture
def feed(tmp_path: Path) -> Iterator[FeedStandIn]:
    made = FeedStandIn(tmp_path)
    made.made = 30
    (tmp_path / "session.open").touch()
    yield made
    made.close()


def seconds(monkeypatch: pytest.MonkeyPatch, *acts: Callable[[], None]) -> None:
    """Let something happen in each second of the view instead of waiting for it."""
    left = iter(acts)
    monkeypatch.setattr(WallClock, "sleep", lambda self, time_s: next(left)())


def test_a_figure_is_drawn_each_second_until_the_session_is_closed(
    notebook: Notebook, feed: FeedStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def later() -> None:
        feed.made = 700

    def ended() -> None:
        feed.close()
        (tmp_path / "session.open").unlink()

    seconds(monkeypatch, later, ended)
    bench.watch(tmp_path, SIGNAL)
    assert [how for how, _ in notebook.shown] == ["display", "update"]
    (axes,) = notebook.figures[-1].axes
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.get_title()) == ("bench time / s", f"{SIGNAL} / 1", "soak")
    (band,) = axes.collections
    corners = band.get_paths()[0].vertices
    counts = np.arange(100, 700)  # the last minute; point k lies at k / 10 s and spans k + 2 to k + 3 in this column
    for t_s, low in zip(counts / 10, counts + 2, strict=True):
        at = corners[np.isclose(corners[:, 0], t_s)]
        assert (at[:, 1].min(), at[:, 1].max()) == (low, low + 1)


def test_a_busy_run_is_awaited(
    notebook: Notebook, feed: FeedStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its feed is closed, and a living process has its journal open: it writes the end of its recording."""
    (tmp_path / JOURNAL_NAME).touch()
    command = [sys.executable, "-c", HOLDER, str(tmp_path / JOURNAL_NAME)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as writer:
        writer.stdout.readline()
        seconds(monkeypatch, feed.close, lambda: None, (tmp_path / "session.open").unlink)
        bench.watch(tmp_path, SIGNAL)
        writer.stdin.close()
    assert len(notebook.shown) == 1


def unwatched(code: str, path: Path, signal: str = SIGNAL) -> str:
    with pytest.raises(BenchError) as caught:
        bench.watch(path, signal)
    assert caught.value.code == code
    return str(caught.value)


def test_what_cannot_be_shown_is_one_clear_error(
    notebook: Notebook, feed: FeedStandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert SIGNAL in unwatched("B-TAB-010", tmp_path, "port_a.npp[33]")
    unwatched("B-RUN-100", tmp_path / "nothing")
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "matplotlib.figure", None)
        without.setitem(sys.modules, "matplotlib", None)
        assert "inertial-bench[report]" in unwatched("B-PKG-005", tmp_path)
    seconds(monkeypatch, feed.close)
    unwatched("B-RUN-100", tmp_path)  # it died: the session is open, and nobody writes it
    monkeypatch.setitem(sys.modules, "IPython.display", None)
    assert "bench top" in unwatched("B-TAB-011", tmp_path)
