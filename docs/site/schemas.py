"""The pages of the YAML files and of results.json, from their JSON Schemas: keys, types, units, defaults, meaning."""

from __future__ import annotations

import json
from typing import Any

from bench.analysis import results_schema
from bench.plan import json_schemas, mapping_schema

TITLES = {
    "sequence": "Keys of a sequence",
    "station": "Keys of a station",
    "frame": "Keys of a frame definition",
    "mapping": "Keys of a mapping",
    "results": "Keys of results.json",
}
_NAME = r"^[a-z][a-z0-9_]{0,39}$"
_ANY_STEP = "ProcedureStep"  # a list of steps may hold each kind, this one too
_ANY_VALUE = {"true or false", "whole number", "number", "text"}


def schema_pages() -> dict[str, str]:
    """Return the pages as Markdown, by kind of file."""
    schemas = {**json_schemas(), "mapping": mapping_schema(), "results": results_schema()}
    return {kind: _page(kind, schema) for kind, schema in schemas.items()}


def _page(kind: str, schema: dict[str, Any]) -> str:
    lines = [f"# {TITLES[kind]}", "", f"`bench schema` writes the same for editors as `{kind}.schema.json`.", ""]
    if "properties" in schema:
        lines += ["## The file", "", *_model(schema)]
    for name, model in sorted(schema["$defs"].items()):
        lines += [f"## {name}", "", *_model(model)]
    return "\n".join(lines)


def _model(model: dict[str, Any]) -> list[str]:
    """Return what the model means, and a row for each of its keys."""
    lines = [model["description"].replace("\n", " ").replace("  ", "\n\n"), ""] if "description" in model else []
    if not model.get("properties"):
        return lines
    required = set(model.get("required", ()))
    rows = [_row(key, entry, key in required) for key, entry in model["properties"].items()]
    return [*lines, "| key | value | if left out | meaning |", "|---|---|---|---|", *rows, ""]


def _row(key: str, entry: dict[str, Any], required: bool) -> str:
    default = entry.get("default")
    left_out = "" if default in (None, "") or isinstance(default, dict | list) else f"`{_value(default, entry)}`"
    meaning = entry.get("description", "").replace("<", "&lt;")
    if meaning == f"in {_unit(entry)}" or meaning.startswith("a quantity in "):
        meaning = ""
    kind = _kind(entry) + " or null" * (required and {"type": "null"} in entry.get("anyOf", ()))
    cells = (f"`{key}`", kind, "**required**" if required else left_out, meaning)
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def _value(default: Any, entry: dict[str, Any]) -> str:
    """Return a default as a person writes it in YAML: a quantity with its unit."""
    unit = _unit(entry)
    if unit and isinstance(default, float):
        return f"{default:g} {unit}" if unit != "1" else f"{default:g}"
    return default if isinstance(default, str) else json.dumps(default)


def _unit(entry: dict[str, Any]) -> str:
    found = [entry, *entry.get("anyOf", ())]
    return next((other["x-unit"] for other in found if "x-unit" in other), "")


def _kind(entry: dict[str, Any]) -> str:
    """Return in words what a value is."""
    if "x-unit" in entry:
        return "number or per cent" if entry["x-unit"] == "1" else f"quantity in {entry['x-unit']}"
    if "$ref" in entry:
        name = entry["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    for word in ("anyOf", "oneOf"):
        if word in entry:
            return _choice(entry[word])
    if "enum" in entry:
        return ", ".join(f"`{value}`" for value in entry["enum"])
    if "const" in entry:
        return f"`{entry['const']}`"
    return _plain(entry)


def _choice(entries: list[dict[str, Any]]) -> str:
    """Return alternatives; None only says that the key may be left out, and a step is any step."""
    kinds = [_kind(other) for other in entries if other.get("type") != "null"]
    if any(_ANY_STEP in kind for kind in kinds):
        return "step"
    if set(kinds) >= _ANY_VALUE:
        kinds = ["value", *(kind for kind in kinds if kind not in _ANY_VALUE)]
    return " or ".join(dict.fromkeys(kinds))


def _plain(entry: dict[str, Any]) -> str:
    kind = entry.get("type", "anything")
    if kind == "array":
        parts = [_kind(part) for part in entry.get("prefixItems", ())]
        return f"[{', '.join(parts)}]" if parts else f"list of {_kind(entry.get('items', {}))}"
    if kind == "object":
        values = next(iter(entry.get("patternProperties", {}).values()), entry.get("additionalProperties"))
        return f"mapping of names to {_kind(values)}" if isinstance(values, dict) else "mapping"
    if kind == "string":
        return "name" if entry.get("pattern") == _NAME else "text"
    low, high = entry.get("minimum"), entry.get("maximum")
    limits = f" from {low}" * (low is not None) + f" to {high}" * (high is not None)
    return {"boolean": "true or false", "integer": "whole number"}.get(kind, kind) + limits
