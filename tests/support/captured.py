"""All of a capture in memory, as no command keeps it: counts, and the frames of each message."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bench.frame import Counted, Engine, FrameDefinition, MessageBatch, decode_capture


def captured(
    definition: FrameDefinition, path: Path, engine: Engine | None = None
) -> tuple[Counted, dict[str, MessageBatch]]:
    parts: dict[str, list[MessageBatch]] = {name: [] for name in definition.messages}

    def keep(found: Mapping[str, MessageBatch]) -> None:
        for name, batch in found.items():
            parts[name].append(batch)

    with path.open("rb") as stream:
        counted = decode_capture(definition, stream, keep, engine)
    return counted, {name: MessageBatch.join(batches) for name, batches in parts.items()}
