"""A recorded session read again: from its folder to records, events, results and their analysis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis import Analysis
from bench.model.errors import InputError
from bench.plan import steps_of
from bench.record import OPEN_MARKER
from bench.replay import IMPORT, Replayed, replay_rows, replay_series
from bench.session.merge import merged
from bench.session.view import SessionView, analyse_view, happened


def analysed(
    folder: Path, method: str | None, strict: bool = False, make_up: Sequence[Path] = ()
) -> tuple[dict[str, Any], Analysis, SessionView]:
    """Return results, analysis and view of a session, together with the sessions that make up for it.

    Raises: InputError B-CLI-008 if the sequence of the session asks for no analysis; those of ``read_view``.
    """
    view = read_view(folder, strict=strict)
    if make_up:
        view = merged(view, [read_view(other) for other in make_up])
    if not view.has_analysis:
        raise InputError("B-CLI-008", "the sequence of this session asks for no analysis", where=str(folder))
    results, analysis = analyse_view(view, method)
    return results, analysis, view


def read_view(folder: Path, strict: bool = False) -> SessionView:
    """A session as its folder holds it; damage is listed, unless ``strict`` (then SessionDamaged)."""
    replayed = replay_rows(folder, strict=strict)
    notes = [*replayed.notes]
    notes += [f"{name} has no end: the run stopped there, or goes on" for name in replayed.unfinished]
    series: Mapping[str, NDArray[np.float64]] = {}
    if replayed.manifest.get("kind") == IMPORT:
        imported = replay_series(folder)
        series = imported.columns
        notes += imported.notes
    return SessionView(
        manifest=replayed.manifest,
        rows=replayed.measurement_rows,
        counts=replayed.totals,
        session_sha256=replayed.session_sha256,
        plan_steps=steps_of(replayed.texts.get("plan.json", "[]")),
        events=happened(replayed.events),
        notes=notes,
        damage=replayed.damage,
        series=series,
        splices=replayed.splices,
        incomplete=_is_incomplete(folder, replayed),
        utc_offset_ns=replayed.utc_offset_ns,
        texts=replayed.texts,
    )


def _is_incomplete(folder: Path, replayed: Replayed) -> bool:
    """The run goes on, was stopped, or its last segment has no end; other software may write no "end" event."""
    last = next((fields for kind, _, fields in reversed(replayed.events) if kind in ("end", "resume")), None)
    stopped = last is not None and (last.get("error") is not None or "steps" not in last)
    newest = max(path.name for path in folder.glob("session.*.mcap"))
    return stopped or newest in replayed.unfinished or (folder / OPEN_MARKER).exists()
