"""The JSON Schemas say the same as the loader, for every shipped file and for typical slips."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from plan_sample import FLAT, SEQUENCE, changed
from pydantic import RootModel

from bench.model.yamlio import load_yaml, parse_yaml
from bench.plan.schemas import json_schemas, vscode_settings

ROOT = Path(__file__).resolve().parents[3]
FILES = [
    (kind, path) for kind in ("sequence", "frame", "station") for path in sorted((ROOT / f"{kind}s").glob("*.yaml"))
]


SCHEMAS = json_schemas()


def errors(kind: str, tree: Any) -> list[str]:
    return [error.message for error in Draft202012Validator(SCHEMAS[kind]).iter_errors(tree)]


@pytest.mark.parametrize("kind", ["sequence", "frame", "station"])
def test_each_is_a_schema_and_plain_json(kind: str) -> None:
    schema = SCHEMAS[kind]
    Draft202012Validator.check_schema(schema)
    assert json.loads(json.dumps(schema)) == schema


@pytest.mark.parametrize(("kind", "path"), FILES, ids=lambda value: getattr(value, "stem", value))
def test_shipped_files_are_valid(kind: str, path: Path) -> None:
    assert errors(kind, load_yaml(path, RootModel[Any]).model.root) == []


@pytest.mark.parametrize("text", [SEQUENCE, FLAT])
def test_samples_are_valid(text: str) -> None:
    assert errors("sequence", parse_yaml(text, "s", RootModel[Any]).model.root) == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("title:", "titel:"),
        ("- settle: 5 s", "- settle: 5"),
        ("- settle: 5 s", "- {settle: 5 s, record: 5 s}"),
        ("slot: 570 s", "slots: 570 s"),
        ("kind: gyro", "kind: gyroscope"),
        ("- calibrator.standby", "- Calibrator.standby"),
        ("- calibrator.standby", "- [calibrator.standby]"),
    ],
)
def test_slips_are_marked_in_the_editor(old: str, new: str) -> None:
    assert errors("sequence", parse_yaml(changed(old, new), "s", RootModel[Any]).model.root)


def test_the_editor_knows_which_schema_belongs_where() -> None:
    assert vscode_settings()["yaml.schemas"] == {
        "schemas/sequence.schema.json": "sequences/*.yaml",
        "schemas/frame.schema.json": "frames/*.yaml",
        "schemas/station.schema.json": "stations/*.yaml",
    }
