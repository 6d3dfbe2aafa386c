"""The mapping language: what a file may say, a mistake in every key with its place, its schema and its description."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from import_sample import RAMP, SHORT
from jsonschema import Draft202012Validator
from pydantic import RootModel

from bench.model.errors import InputError, InputErrors
from bench.model.yamlio import load_yaml, parse_yaml
from bench.plan import mapping_schema
from bench.plan.language.mapping import FileForm, TimeColumn, ValueColumn, load_mapping, mapping_model
from bench.replay.delimited import LogParser

ROOT = Path(__file__).resolve().parents[3]
SHIPPED = sorted((ROOT / "docs" / "mappings").glob("*.yaml"))
TIME = "time: {role: time, format: iso, zone: UTC}"
# what is changed, into what, and a word of the message; the error stands on the line that was changed
MISTAKES = [
    ("mapping: any_log", "mapping: Any Log", "mapping"),
    ("uut: {model: M, serial: S-1}", "uut: {model: M}", "serial"),
    ("uut:", "title: [a]\nuut:", "title"),
    ("uut:", "unit: {a: b}\nuut:", "unknown key 'unit'"),
    ("uut:", "analysis: Temperature ramp\nuut:", "analysis"),
    ("uut:", "reference_temperature: 20\nuut:", "has no unit"),
    ("uut:", "bad_rows: 0.01\nuut:", "has no unit"),
    ("uut:", "bad_rows: 101 %\nuut:", "above the limit"),
    ("uut:", 'file: {delimiter: ", "}\nuut:', "delimiter"),
    ("uut:", "file: {header: 0}\nuut:", "header"),
    ("uut:", "file: {decimal: ;}\nuut:", "decimal"),
    ("uut:", 'file: {delimiter: ",", decimal: ","}\nuut:', "both decimal sign and delimiter"),
    ("uut:", 'file: {comment: ""}\nuut:', "comment"),
    ("uut:", "file: {encoding: ebcdic}\nuut:", "encoding"),
    ("uut:", "overload: {at_least: -1}\nuut:", "at_least"),
    ("uut:", "overload: {values: 9.9e37}\nuut:", "values"),
    ("format: iso", "format: yesterday", "yesterday"),
    ("format: iso", 'format: "%H:%M:%S"', "does not tell date and time"),
    ("format: iso", 'format: "%d/%m/%y %q"', "no pattern"),
    ("format: iso, zone: UTC", "format: iso", "needs 'zone'"),
    ("zone: UTC", "zone: CET", "zone"),
    ("zone: UTC", "zone: UTC, start: 2024-01-01T00:00:00Z", "takes no 'start'"),
    ("format: iso, zone: UTC", "format: unix", "needs 'unit'"),
    ("format: iso, zone: UTC", "format: unix, unit: mV", "no unit of time"),
    ("format: iso, zone: UTC", "format: elapsed, unit: s", "needs 'start'"),
    ("format: iso, zone: UTC", "format: elapsed, unit: s, start: now", "no time such as"),
    ("format: iso, zone: UTC", "format: elapsed, unit: s, start: 2024-01-01T00:00:00", "has no zone"),
    ("role: temperature", "role: temprature", "role"),
    ("quantity: sensor", "quantity: Sensor 1", "quantity"),
    ("quantity: sensor, ", "", "quantity"),
    ("unit: mV", "unit: millivolt", "no unit"),
]
PAGE = (Path(__file__).resolve().parents[3] / "docs" / "importing.md").read_text(encoding="utf-8")


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
        ("uut:", "analysis: temperature_ramp\nuut:", ""),
    ],
)
def test_columns_must_fit_together(old: str, new: str, word: str) -> None:
    text = SHORT.replace(old, new, 1)
    if not word:  # a valid one
        assert parse_yaml(text, "m.yaml", mapping_model()).model.analysis == "temperature_ramp"
        return
    with pytest.raises(InputErrors, match="B-YAML-012") as raised:
        parse_yaml(text, "m.yaml", mapping_model())
    assert word in str(raised.value)


IMU = "analysis: imu_strapdown\nsite: {gravity: 9.8 m/s2}\nuut:"


def test_a_wrong_role_names_those_of_the_analysis() -> None:
    for role in ("gyroscope", "reading"):
        with pytest.raises(InputErrors, match=f"'{role}'") as raised:
            parse_yaml(SHORT.replace("uut:", IMU, 1).replace("reading", role), "m.yaml", mapping_model())
        said = str(raised.value)
        assert re.search("'?time'?, '?gyro'?, '?accelerometer'?, '?temperature'?, '?ignore'?", said), said
        assert "set_point" not in said


def test_a_file_of_another_kind_is_named_with_its_command(tmp_path: Path) -> None:
    frame = ROOT / "frames" / "imu_200.yaml"
    with pytest.raises(InputError, match=r"B-SHIP-002: .*this is a frame, and a mapping is due.*bench decode"):
        load_mapping(frame)
    with pytest.raises(InputError, match="B-YAML-001"):
        load_mapping(tmp_path / "none.yaml")


def test_an_analysis_needs_temperature_and_reading() -> None:
    text = SHORT.replace("role: reading", "role: reference").replace("uut:", "analysis: temperature_ramp\nuut:")
    with pytest.raises(InputErrors, match="of the roles temperature and reading"):
        parse_yaml(text, "m.yaml", mapping_model())


def test_what_the_manifest_gets() -> None:
    campaign = parse_yaml(RAMP, "m.yaml", mapping_model()).model.campaign()
    assert campaign["analysis"] == "temperature_ramp"
    assert campaign["reference_temperature_degC"] == 25.0
    assert campaign["uut"] == {"model": "M", "serial": "7"}
    assert {"header": "dmm", "name": "meter", "role": "reading", "unit": "V"} in campaign["columns"]
    assert [one["name"] for one in campaign["columns"]] == ["set_point", "sensor_1", "sensor_2", "standard", "meter"]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_mappings_are_valid_for_loader_and_editor(path: Path) -> None:
    assert load_mapping(path).model.mapping == path.stem
    tree = load_yaml(path, RootModel[Any]).model.root
    assert list(Draft202012Validator(mapping_schema()).iter_errors(tree)) == []


def test_the_schema_marks_slips() -> None:
    schema = mapping_schema()
    Draft202012Validator.check_schema(schema)
    assert json.loads(json.dumps(schema)) == schema
    for old, new in (("uut:", "uuut:"), ("role: reading", "role: readings"), ("unit: mV", "unti: mV")):
        tree = parse_yaml(SHORT.replace(old, new, 1), "m", RootModel[Any]).model.root
        assert list(Draft202012Validator(schema).iter_errors(tree)), new


def test_the_ten_line_mapping_reads_the_file_above_it() -> None:
    found = re.search(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    assert len(found[1].splitlines()) == 10
    parser = LogParser(parse_yaml(found[1], "importing.md", mapping_model()).model, "example")
    lines = [line.strip() for line in PAGE.splitlines() if re.match(r"    (time,|2024-)", line)]
    rows = [parser.row(line.encode()) for line in lines]
    assert [row.values for row in rows if row is not None] == [(20.0, 20.31, 1.0000123), (20.0, 20.3, 1.0000125)]


def test_every_key_is_explained() -> None:
    keys = {name for model in (mapping_model(), FileForm, TimeColumn, ValueColumn) for name in model.model_fields}
    assert {key for key in keys if f"`{key}" not in PAGE} == set()
