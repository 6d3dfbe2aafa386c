"""Standards in place of those that a session recorded: what would its results be with a corrected certificate?

Every analysis reads the register from the manifest, so this is the one place where another one enters. The session
itself is not changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import Field

from bench.model.yamlio import StrictModel, load_yaml
from bench.plan import Standard, Words, told_standard
from bench.session.view import SessionView

Register = Mapping[str, Mapping[str, Any]]


class RegisterFile(StrictModel):
    """Standards as a station file has them, each under the number of the certificate that the sessions recorded."""

    certificates: dict[Words, Standard] = Field(min_length=1, description="by number, as recorded")


def load_register(path: Path) -> Register:
    """Read a register file; returns the entries of a manifest by the certificate in whose place they stand.

    Raises: InputErrors (B-YAML-...) with every mistake.
    """
    file = load_yaml(path, RegisterFile).model
    return {number: told_standard("", standard) for number, standard in file.certificates.items()}


def with_register(view: SessionView, register: Register) -> SessionView:
    """Return a session as if its standards had had other certificates; a standard is known by model and serial."""
    recorded = view.manifest.get("standards", {})
    changed = {role: dict(entry) for role, entry in _changed(recorded, register)}
    return replace(view, manifest={**view.manifest, "standards": {**recorded, **changed}}) if changed else view


def _changed(recorded: Register, register: Register) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for role, entry in recorded.items():
        other = register.get(str(entry.get("certificate")))
        if other is not None and all(str(entry.get(name)) == other[name] for name in ("model", "serial")):
            yield role, {**other, "driver": entry.get("driver", "")}
