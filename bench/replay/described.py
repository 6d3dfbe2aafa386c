"""Frames, signals and graph windows of a recorded session, as its own texts describe them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

from bench.frame import FrameDefinition, Signal, parse_frame
from bench.model.errors import InputError
from bench.model.quantities import Values
from bench.model.yamlio import parse_yaml
from bench.plan import Graph, GraphEntry, StationFile, graphs_of, shown_signals
from bench.record import SessionReader

KEPT = 16


def frames_of(manifest: Values, texts: Mapping[str, str]) -> dict[str, FrameDefinition]:
    """Return frame definitions by link; a link whose text is not in the session, or cannot be read, is left out."""
    frames = {}
    for link, name in sorted(manifest.get("links", {}).items()):
        try:
            frames[link] = parse_frame(texts[name], name)
        except (KeyError, InputError):
            continue
    return frames


def entries_of(manifest: Values, texts: Mapping[str, str]) -> Sequence[GraphEntry]:
    """Return the section ``graphs`` of the session's station; none if its text is not there or cannot be read today."""
    name = f"stations/{manifest.get('station')}.yaml"
    try:
        return parse_yaml(texts[name], name, StationFile).model.graphs
    except (KeyError, InputError):
        return ()


def session_signals(manifest: Values, texts: Mapping[str, str]) -> tuple[Signal, ...]:
    """Return every signal of a session: those of its frames, what its graphs ask for, and those of the bench."""
    return shown_signals(session_graphs(manifest, texts), frames_of(manifest, texts))


def session_graphs(manifest: Values, texts: Mapping[str, str]) -> list[Graph]:
    """Return graph windows of a session; where its station names none, some that suit its frames."""
    frames = frames_of(manifest, texts)
    return graphs_of(entries_of(manifest, texts), frames, str(manifest.get("measurement_link", "")))


def session_frames(folder: Path) -> Mapping[str, FrameDefinition]:
    """Return frame definitions by link, as ``frames_of`` gives them; a session's texts never change.

    Raises: InputError B-REC-010 (no session); SessionDamaged B-REC-012, B-REC-014.
    """
    of_file = SessionReader(folder).segments[0].stat().st_ino  # another one at the same place is another session
    return _frames(folder, of_file)


@lru_cache(maxsize=KEPT)
def _frames(folder: Path, first_segment: int) -> Mapping[str, FrameDefinition]:
    del first_segment
    reader = SessionReader(folder)
    return frames_of(reader.manifest, reader.texts)
