"""``bench schema``: JSON Schemas for editors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bench.analysis import results_schema
from bench.commands.console import say
from bench.model.errors import InputError
from bench.model.systems import system_refusals
from bench.plan import json_schemas, mapping_schema, vscode_settings
from bench.session.coefficients import all_modules
from bench.session.output import write_file


def schema(folder: Path, vscode: bool) -> None:
    """Write one schema file per kind of file; with ``vscode`` also register them in .vscode/settings.json."""
    kinds: dict[str, Any] = {**json_schemas(), "results": results_schema(), "mapping": mapping_schema()}
    kinds |= {module.NAME: module.coefficients_schema() for module in all_modules()}
    for kind, content in kinds.items():
        write_file(folder / f"{kind}.schema.json", json.dumps(content, indent=1, sort_keys=True) + "\n")
    say(f"{len(kinds)} schemas written to {folder}")
    for offer, error in system_refusals():
        say(f"without {offer.what} of {offer.release}: {error}")
    if vscode:
        _register(folder)


def _register(folder: Path) -> None:
    path = Path(".vscode/settings.json")
    try:
        settings = json.loads(path.read_text() if path.exists() else "{}")
        registered = settings.setdefault("yaml.schemas", {})
        registered.update(vscode_settings(f"./{folder.as_posix()}")["yaml.schemas"])
    except (ValueError, AttributeError) as error:  # comments, or a list where an object is due
        raise InputError(
            "B-CLI-002",
            f"is not plain JSON ({error}); nothing was changed",
            where=path,
            next_step="remove the comments, or register the schemas by hand",
        ) from error
    write_file(path, json.dumps(settings, indent=1) + "\n")
    say(f"registered in {path} (the YAML extension of the editor reads them)")
