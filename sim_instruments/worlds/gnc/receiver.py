"""The receiver of the test board: bytes in, requests out; it gives up what an interruption has left unfinished."""

from __future__ import annotations

from dataclasses import dataclass

from bench.frame import FrameBatch, FrameDefinition

SILENCE_NS = 50_000_000  # between two bytes of a frame at most
BOARD = 0x10


@dataclass(frozen=True)
class Request:
    """One command as it came."""

    source: int
    sequence: int
    command: int
    payload: bytes


class BoardReceiver:
    """Finds commands to this board; a frame with a wrong check costs one byte, not its claimed length."""

    def __init__(self, definition: FrameDefinition) -> None:
        self._decoder = definition.decoder("reference")
        self.heard_ns = 0  # end of the last byte

    def feed(self, received: bytes, end_ns: int) -> list[Request]:
        """Commands completed by these bytes, the last of which ends at ``end_ns``."""
        self.heard_ns = end_ns
        return _requests(self._decoder.feed(received))

    def silence(self) -> list[Request]:
        """Nothing came for longer than a frame may be interrupted: what was begun is given up, search goes on in it."""
        return _requests(self._decoder.finish())


def _requests(batch: FrameBatch) -> list[Request]:
    found = batch.messages["command"]
    columns = zip(
        *(found.raw(name) for name in ("destination", "source", "sequence", "command", "payload")), strict=True
    )
    return [
        Request(int(source), int(sequence), int(command), bytes(payload))
        for destination, source, sequence, command, payload in columns
        if destination == BOARD
    ]
