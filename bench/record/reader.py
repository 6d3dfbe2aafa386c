"""Reads a session: verifies everything on the way, reports damage instead of dying of it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

from bench.model.errors import SessionDamaged
from bench.model.segments import session_segments
from bench.record import layout
from bench.record.layout import Message
from bench.record.scan import Damage
from bench.record.summary import chunks_with, read_summary
from bench.record.walk import Walk


class SessionReader:
    """A recorded session.

    Args: folder: the session's folder.
          strict: raise SessionDamaged B-REC-011 at the first damaged segment instead of going on.
    Raises: InputError B-REC-010 if the folder holds no segment.

    A session is walked once, when one of ``damage``, ``sha256``, ``counts`` or ``unfinished`` is asked for, or when
    ``messages`` has been iterated to its end.
    """

    def __init__(self, folder: Path, *, strict: bool = False) -> None:
        self.folder = folder
        self._strict = strict
        self._walk: Walk | None = None
        self.segments = session_segments(folder)

    def messages(self, topics: frozenset[str] | None = None) -> Iterator[Message]:
        """Every message in the order of recording, or those of ``topics`` (a topic ending in "/" means all below it).

        The whole session is walked and verified, whatever is selected.
        """
        walk = Walk(topics)
        self._missing_segments(walk)
        for path in self.segments:
            yield from walk.segment(path.name, path.read_bytes())
            if self._strict and walk.damage:
                raise _damaged(self.folder, walk.damage)
        self._walk = walk

    def select(self, topics: frozenset[str]) -> Iterator[Message]:
        """Yield messages of a few topics, through the chunk indexes: fast, and nothing else is read or verified."""
        walk = Walk(topics)
        for path in self.segments:
            content = path.read_bytes()
            summary = read_summary(content)
            channels = summary.channels if summary else {}
            wanted = frozenset(number for number, topic in channels.items() if layout.matches(topic, topics))
            offsets = chunks_with(content, summary, wanted) if summary else None
            if summary is None or offsets is None:
                yield from walk.segment(path.name, content)
            else:
                yield from walk.chunks(path.name, content, summary, offsets)

    def events(self, kind: str | None = None) -> Iterator[tuple[str, int, dict[str, Any]]]:
        """Yield events (kind, t_mono_ns, fields) in order, all or of one kind."""
        for message in self.select(frozenset({layout.EVENT})):
            found, fields = message.event()
            if kind is None or found == kind:
                yield found, message.t_ns, fields

    @cached_property
    def _head(self) -> tuple[dict[str, Any] | None, dict[str, str]]:
        manifest: dict[str, Any] | None = None
        texts: dict[str, str] = {}
        for message in Walk(None).segment(self.segments[0].name, self.segments[0].read_bytes()):
            if message.topic == layout.MANIFEST:
                manifest = message.document() if manifest is None else manifest
            elif message.topic.startswith(layout.TEXT):
                texts.setdefault(message.topic.removeprefix(layout.TEXT), message.text())
            else:
                break
        return manifest, texts

    @property
    def manifest(self) -> dict[str, Any]:
        """The manifest. Raises SessionDamaged B-REC-012 if it is lost, B-REC-014 if it is no JSON."""
        manifest = self._head[0]
        if manifest is None:
            raise SessionDamaged(
                "B-REC-012",
                "the manifest is missing or damaged",
                where=str(self.segments[0]),
                next_step="'bench recover' lists what the session still holds",
            )
        return manifest

    @property
    def texts(self) -> dict[str, str]:
        """Text of the compiled plan and of every YAML, by file name."""
        return self._head[1]

    def _walked(self) -> Walk:
        if self._walk is None:
            for _ in self.messages(frozenset()):
                pass
        assert self._walk is not None
        return self._walk

    @property
    def damage(self) -> list[Damage]:
        """Every damaged place, in file order; empty if all of the session is as it was written."""
        return self._walked().damage

    @property
    def unfinished(self) -> list[str]:
        """Segments without an end (crash, or still being written): whole up to their last chunk."""
        return self._walked().unfinished

    @property
    def sha256(self) -> str:
        """Chain value of the last segment: covers all segments in order."""
        return self._walked().chain.hex()

    @property
    def counts(self) -> dict[str, int]:
        """Number of good messages by topic."""
        return self._walked().counts

    @property
    def next_sequence(self) -> int:
        """Running number that follows the last good message."""
        return self._walked().expected

    @property
    def topics(self) -> dict[int, str]:
        """Channel numbers and topics of the last segment."""
        return self._walked().topics

    def _missing_segments(self, walk: Walk) -> None:
        present = {int(path.name.split(".")[1]) for path in self.segments}
        for number in sorted(set(range(1, max(present) + 1)) - present):
            walk.damage.append(Damage(layout.segment_name(number), 0, "segment is missing"))


def _damaged(folder: Path, damage: list[Damage]) -> SessionDamaged:
    more = f" and {len(damage) - 1} more" if len(damage) > 1 else ""
    return SessionDamaged(
        "B-REC-011",
        f"{damage[0]}{more}",
        where=str(folder),
        next_step="'bench recover' lists what the session still holds",
    )
