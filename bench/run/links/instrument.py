"""A link whose bytes an instrument has buffered: the acquisition reads it as it reads a port."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from bench.model.errors import InputError, InstrumentError
from bench.model.ports import Instrument


@runtime_checkable
class StreamSource(Protocol):
    """An instrument that measures by itself and keeps what it finds until it is read."""

    def read_stream(self, most_bytes: int) -> bytes:
        """Return what is buffered, at most so much; b"" at once if there is nothing. Raises: InstrumentError."""


class InstrumentLink:
    """A ByteLink on the buffer of an instrument; reading it again is all it takes to open it again.

    Raises: InputError B-RUN-007 if the instrument has no such buffer.
    """

    def __init__(self, name: str, instrument: Instrument) -> None:
        if not isinstance(instrument, StreamSource):
            message = f"{instrument.role} buffers nothing that could be read as a link"
            raise InputError("B-RUN-007", message, where=name, next_step="name another instrument in the station file")
        self._source: StreamSource = instrument

    def read(self, size: int = 1) -> bytes:
        """Return what the instrument has buffered. Raises: OSError if it cannot be read."""
        try:
            return self._source.read_stream(size)
        except InstrumentError as error:
            raise OSError(error.message) from error

    def write(self, data: bytes) -> int | None:
        """Raises: OSError: a buffer takes no commands."""
        raise OSError(f"{len(data)} bytes for an instrument, which is commanded over its bus")

    @property
    def in_waiting(self) -> int:
        """Nobody knows before it is read."""
        return 0

    def close(self) -> None:
        """The instrument is closed by whoever opened it."""

    def reopen(self) -> None:
        """The next reading shows whether it is there."""
