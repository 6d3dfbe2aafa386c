"""Schemas, graphs and mappings: the same as the loader says, a mistake in every key with its place."""

import json
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from imported_logs import RAMP, SHORT
from jsonschema import Draft202012Validator
from plan_sample import changed, make_bench, mistakes
from pydantic import RootModel
from trend_sample import FRAMES, ROOT

from bench.frame import load_frame
from bench.model.errors import InputError, InputErrors, words_in
from bench.model.yamlio import SLIPS, load_yaml, parse_yaml
from bench.plan import load_station, mapping_schema
from bench.plan.language.graphs import GraphEntry, graphs_of, shown_signals
from bench.plan.language.mapping import load_mapping, mapping_model
from bench.plan.schemas import json_schemas
from bench.plan.served import served_station
from bench.plan.station import StationFile
from bench.replay.described import session_graphs, session_signals

FILES = [
    (kind, path) for kind in ("sequence", "frame", "station") for path in sorted((ROOT / f"{kind}s").glob("*.yaml"))
]


SCHEMAS = json_schemas() | {"mapping": mapping_schema()}


def errors(kind: str, tree: Any) -> list[str]:
    return [error.message for error in Draft202012Validator(SCHEMAS[kind]).iter_errors(tree)]


@pytest.mark.parametrize("kind", SCHEMAS)
def test_each_is_a_schema_and_plain_json(kind: str) -> None:
    schema = SCHEMAS[kind]
    Draft202012Validator.check_schema(schema)
    assert json.loads(json.dumps(schema)) == schema


def patterns(part: Any) -> set[str]:
    inner = part.values() if isinstance(part, dict) else part if isinstance(part, list) else ()
    own = part.get("pattern") if isinstance(part, dict) and "x-unit" not in part else None
    return {own}.union(*map(patterns, inner)) if isinstance(own, str) else set().union(*map(patterns, inner))


@pytest.mark.parametrize("kind", SCHEMAS)
def test_each_pattern_of_a_text_has_words(kind: str) -> None:
    assert patterns(SCHEMAS[kind]) - words_in(SLIPS).keys() == set()


@pytest.mark.parametrize(("kind", "path"), FILES, ids=lambda value: getattr(value, "stem", value))
def test_shipped_files_are_valid(kind: str, path: Path) -> None:
    assert errors(kind, load_yaml(path, RootModel[Any]).model.root) == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("title:", "titel:"),
        ("- settle: 5 s", "- settle: 5"),
        ("- settle: 5 s", "- {settle: 5 s, record: 5 s}"),
        ("slot: 570 s", "slots: 570 s"),
        ("kind: gyro", "kind: gyroscope"),
        ("- calibrator.standby", "- Calibrator.standby"),
    ],
)
def test_slips_are_marked_in_the_editor(old: str, new: str) -> None:
    assert errors("sequence", parse_yaml(changed(old, new), "s", RootModel[Any]).model.root)
    frame = load_yaml(ROOT / "frames" / "ngu_a.yaml", RootModel[Any]).model.root
    assert errors("frame", frame | {"colour": "blue"})
    assert errors("frame", frame | {"fields": [{"name": "v", "type": "u65"}]})
    for right, wrong in (("uut:", "uuut:"), ("role: reading", "role: readings"), ("unit: mV", "unti: mV")):
        assert errors("mapping", parse_yaml(SHORT.replace(right, wrong, 1), "m", RootModel[Any]).model.root), wrong


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


MAPPINGS = sorted((ROOT / "docs" / "mappings").glob("*.yaml"))
TIME = "time: {role: time, format: iso, zone: UTC}"
# what is changed, into what, and a word of the message; the error stands on the line that was changed
MISTAKES = [
    ("uut: {model: M, serial: S-1}", "uut: {model: M}", "serial"),
    ("uut:", "unit: {a: b}\nuut:", "unknown key 'unit'"),
    ("uut:", "reference_temperature: 20\nuut:", "has no unit"),
    ("uut:", 'file: {delimiter: ",", decimal: ","}\nuut:', "both decimal sign and delimiter"),
    ("uut:", 'file: {comment: ""}\nuut:', "comment"),
    ("uut:", "overload: {values: 9.9e37}\nuut:", "values"),
    ("format: iso", "format: yesterday", "yesterday"),
    ("format: iso", 'format: "%H:%M:%S"', "does not tell date and time"),
    ("format: iso, zone: UTC", "format: iso", "needs 'zone'"),
    ("zone: UTC", "zone: UTC, start: 2024-01-01T00:00:00Z", "takes no 'start'"),
    ("format: iso, zone: UTC", "format: unix", "needs 'unit'"),
    ("format: iso, zone: UTC", "format: unix, unit: mV", "no unit of time"),
    ("format: iso, zone: UTC", "format: elapsed, unit: s", "needs 'start'"),
    ("format: iso, zone: UTC", "format: elapsed, unit: s, start: now", "no time such as"),
    ("format: iso, zone: UTC", "format: elapsed, unit: s, start: 2024-01-01T00:00:00", "has no zone"),
    ("quantity: sensor, ", "", "quantity"),
    ("unit: mV", "unit: millivolt", "no unit"),
]


@pytest.mark.parametrize(("old", "new", "word"), MISTAKES)
def test_a_mistake_in_any_key_is_named_where_it_stands(old: str, new: str, word: str) -> None:
    assert old in SHORT
    text = SHORT.replace(old, new, 1)
    with pytest.raises(InputErrors) as raised:
        parse_yaml(text, "m.yaml", mapping_model())
    said = [str(error) for error in raised.value.errors]
    assert any(word in one for one in said), said
    line = text[: text.index(new) if new else text.index("T: {role")].count("\n") + 1
    assert all(one.split(": ")[1].startswith(f"m.yaml:{line}:") for one in said), said


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        (TIME, "a: {role: ignore}", "0 columns have the role time"),
        ("  T:", f"  t2: {TIME[6:]}\n  T:", "2 columns have the role time"),
        ("quantity: voltage", "quantity: sensor", "two columns have the quantity 'sensor'"),
        ("unit: degC", "unit: V", "needs the unit degC"),
        ("  U:", "  R: {role: reference, quantity: r, unit: A}\n  U:", "different units"),
        ("uut:", "analysis: temperature_ramp\nuut:", "of the roles temperature and reading"),
    ],
)
def test_columns_must_fit_together(old: str, new: str, word: str) -> None:
    text = SHORT.replace(old, new, 1)
    if "temperature_ramp" in new:
        assert parse_yaml(text, "m.yaml", mapping_model()).model.analysis == "temperature_ramp"
        text = text.replace("role: reading", "role: reference")
    with pytest.raises(InputErrors, match="B-YAML-012") as raised:
        parse_yaml(text, "m.yaml", mapping_model())
    assert word in str(raised.value)


def test_a_file_of_another_kind_is_named_with_its_command(tmp_path: Path) -> None:
    frame = ROOT / "frames" / "imu_200.yaml"
    with pytest.raises(InputError, match=r"B-SHIP-002: .*this is a frame, and a mapping is due.*bench decode"):
        load_mapping(frame)
    with pytest.raises(InputError, match="B-YAML-001"):
        load_mapping(tmp_path / "none.yaml")


def test_what_the_manifest_gets() -> None:
    campaign = parse_yaml(RAMP, "m.yaml", mapping_model()).model.campaign()
    assert campaign["analysis"] == "temperature_ramp"
    assert campaign["reference_temperature_degC"] == 25.0
    assert campaign["uut"] == {"model": "M", "serial": "7"}
    assert {"header": "dmm", "name": "meter", "role": "reading", "unit": "V"} in campaign["columns"]
    assert [one["name"] for one in campaign["columns"]] == ["set_point", "sensor_1", "sensor_2", "standard", "meter"]


@pytest.mark.parametrize("path", MAPPINGS, ids=lambda path: path.stem)
def test_shipped_mappings_are_valid_for_loader_and_editor(path: Path) -> None:
    assert load_mapping(path).model.mapping == path.stem
    assert errors("mapping", load_yaml(path, RootModel[Any]).model.root) == []
