"""The plan of a session, made again from what the session holds: its steps as stored and its own YAML texts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

from bench.model.errors import InputError, SessionDamaged
from bench.model.lab import recorded_code, require_code, shipped_folder
from bench.model.quantities import Values
from bench.plan.compile import compile_sequence
from bench.plan.plan import Plan, Step, steps_sha256
from bench.plan.station import load_station
from bench.plan.step_kinds import steps_of

_KINDS: tuple[Literal["sequences", "stations", "frames"], ...] = ("sequences", "stations", "frames")
_TEXT = re.compile(r"(sequences|stations|frames)/[A-Za-z0-9_][A-Za-z0-9_.-]*\.yaml")
PLAN = "plan.json"


def frozen_plan(folder: Path, manifest: Values, texts: Mapping[str, str]) -> Plan:
    """Return the plan of a session: steps as they were stored, everything else from its own YAML texts.

    Nothing outside the session is read but code of a lab folder that it asks for.
    ``files`` of the plan are the shipped files of the same names, if there are.
    Raises: InputError B-RES-003 (the session holds no plan), InstallationError B-LAB-007 (code of a lab folder is not
            here), SessionDamaged B-RES-004 (texts or plan are not whole).
    """
    if PLAN not in texts:
        raise _no_plan(folder)
    steps = steps_of(texts[PLAN], str(folder))
    if steps_sha256(steps) != manifest.get("plan_sha256"):
        raise _not_whole(folder, "its plan has another hash than its manifest says")
    return plan_of_texts(folder, manifest, texts, steps)


def plan_of_texts(folder: Path, manifest: Values, texts: Mapping[str, str], steps: Sequence[Step]) -> Plan:
    """Return a plan of steps that are known, everything else from the YAML texts of a session.

    Raises: InputError B-RES-003, InstallationError B-LAB-007, SessionDamaged B-RES-004, as ``frozen_plan``.
    """
    if "sequence" not in manifest:
        raise _no_plan(folder)
    require_code(*recorded_code(manifest))
    try:
        plan = _compiled(manifest, texts)
    except (InputError, OSError, StopIteration) as error:
        raise _not_whole(folder, f"its YAML texts do not compile: {error}") from error
    return replace(plan, steps=tuple(steps), sha256=str(manifest["plan_sha256"]), files=_files(plan, texts))


def _files(plan: Plan, texts: Mapping[str, str]) -> dict[str, str]:
    """Return shipped files of the names of the texts; where a station of its own was read from is unknown."""
    kinds = [kind for kind in _KINDS if kind != "stations" or plan.station.in_process]
    named = {name: shipped_folder(kind) / Path(name).name for kind in kinds for name in texts if name.startswith(kind)}
    return {name: str(path) for name, path in named.items() if path.is_file()}


def _compiled(manifest: Values, texts: Mapping[str, str]) -> Plan:
    with TemporaryDirectory() as place:
        for name, text in texts.items():
            if _TEXT.fullmatch(name):
                path = Path(place, name)
                path.parent.mkdir(exist_ok=True)
                path.write_text(text, encoding="utf-8")
        station = load_station(next(Path(place, "stations").glob("*.yaml")))
        sequence = Path(place, "sequences", f"{manifest['sequence']}.yaml")
        return compile_sequence(sequence, station, dict(manifest.get("settings", {})))


def _no_plan(folder: Path) -> InputError:
    return InputError(
        "B-RES-003",
        "holds no plan to go on with: it was imported, recorded by hand, or written by other software",
        where=str(folder),
        next_step="name the folder of a session that 'bench run' has begun",
    )


def _not_whole(folder: Path, why: str) -> SessionDamaged:
    return SessionDamaged(
        "B-RES-004",
        f"the configuration in the session is not whole: {why}",
        where=str(folder),
        next_step="'bench recover' lists what the session still holds and writes a make-up sequence",
    )
