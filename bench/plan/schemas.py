"""JSON Schemas of the YAML files, so that an editor can complete and check them while they are written."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from bench.frame import FrameSpec
from bench.plan.language.mapping import mapping_model
from bench.plan.language.sequence import sequence_model
from bench.plan.station import StationFile

DIALECT = "https://json-schema.org/draft/2020-12/schema"
FOLDERS = {"sequence": "sequences", "frame": "frames", "station": "stations"}


def json_schemas() -> dict[str, dict[str, Any]]:
    """Return schemas of the three kinds of file, by kind: "sequence", "frame", "station"."""
    models: dict[str, type[BaseModel]] = {"sequence": sequence_model(), "frame": FrameSpec, "station": StationFile}
    return {kind: _schema(kind, model) for kind, model in models.items()}


def mapping_schema() -> dict[str, Any]:
    """Return JSON Schema of a mapping file, for editors."""
    return _schema("mapping", mapping_model())


def vscode_settings(folder: str = "schemas") -> dict[str, Any]:
    """Return settings that tell the YAML extension of the editor which schema belongs to which files."""
    return {"yaml.schemas": {f"{folder}/{kind}.schema.json": f"{FOLDERS[kind]}/*.yaml" for kind in FOLDERS}}


def _schema(kind: str, model: type[BaseModel]) -> dict[str, Any]:
    schema = model.model_json_schema(by_alias=True)
    return {"$schema": DIALECT, "$id": f"{kind}.schema.json", **schema, "title": f"inertial-bench {kind}"}
