"""Decoded frames as tables, written while they are decoded: CSV, or Parquet."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from bench.frame.batch import MessageBatch
from bench.frame.definition import FrameDefinition
from bench.frame.layout import OFFSET, Field
from bench.model.arrays import Array
from bench.model.errors import InputError

_ROWS_AT_ONCE = 20_000
_ROWS_OF_A_GROUP = 500_000  # of Parquet: each group costs some 30 kB of memory until the end
Write = Callable[[MessageBatch], None]


def columns_of(item: Field) -> Iterator[tuple[str, str, list[str]]]:
    """Yield a field and its named bits, each with its unit and the names of its columns: one for each element."""
    for name in (item.name, *(f"{item.name}.{bits}" for bits in item.bits)):
        unit = item.unit if name == item.name else ""
        numbers = [""] if item.count is None or item.kind == "b" else [f"_{index + 1}" for index in range(item.count)]
        yield name, unit, [f"{name}{number}" for number in numbers]


def cells_of(batch: MessageBatch, item: Field, part: slice = slice(None)) -> Iterator[tuple[str, str, Array]]:
    """Yield name, unit and values of each column of a field, (n,), in native byte order.

    Integers are wide and signed where they fit, so that they can be subtracted. Text and bytes are objects; what is
    not there is masked, an empty value of a line is NaN.
    """
    missing = batch.missing(item.name)
    for name, unit, columns in columns_of(item):
        values = (batch.scaled(name) if batch.has_scale(name) else batch.raw(name))[part]
        if item.kind == "b":
            values = _whole(values, item.is_text)
        else:
            is_wide = values.dtype.kind in "iu" and np.can_cast(values.dtype, np.int64)
            values = values.astype(np.int64 if is_wide else values.dtype.newbyteorder("="), copy=False)
        if missing is not None:
            values = np.ma.array(values, mask=missing[part, 0] if item.kind == "b" else missing[part])
        for column, of_element in zip(columns, [values] if values.ndim == 1 else values.T, strict=True):
            yield column, unit, of_element


class Tables:
    """One table per message: byte offset, then every field in its unit but constants, arrays and bit ranges spread.

    A definition with several messages writes ``<stem>.<message><suffix>``. A table has its name when it is whole, and
    ends in ``.part`` until then; what is not finished is removed. A device or pipe is written as it is.

    Args:   path: of the table; ``.parquet`` writes Parquet, any other suffix CSV.
    Raises: InputError B-FRAME-032 (cannot be written), B-FRAME-033 (Parquet without its library).
    """

    def __init__(self, definition: FrameDefinition, path: Path) -> None:
        self._parquet = path.suffix == ".parquet"
        if self._parquet and find_spec("pyarrow") is None:
            raise InputError(
                "B-FRAME-033", "Parquet needs a library that is not installed", where=str(path),
                next_step="install it with: pip install 'inertial-bench[parquet]', or write .csv",
            )  # fmt: skip
        if path.is_dir():
            raise InputError("B-FRAME-032", "is a folder", where=str(path), next_step="name a file in it")
        single = len(definition.messages) == 1
        self.paths = {
            name: path if single else path.with_name(f"{path.stem}.{name}{path.suffix}") for name in definition.messages
        }
        self._lines = definition.layout.lines is not None
        self._open = ExitStack()
        self._writers: dict[str, Write] = {}

    def __enter__(self) -> Tables:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            self._open.close()
            if kind is None:
                for path in self.paths.values():
                    if _part(path) != path:
                        _part(path).replace(path.resolve())
        except OSError as failed:
            raise _unwritten(failed, next(iter(self.paths.values()))) from failed
        finally:
            for path in self.paths.values():
                with suppress(OSError):
                    if _part(path) != path:
                        _part(path).unlink(missing_ok=True)

    def write(self, messages: Mapping[str, MessageBatch]) -> None:
        """Append the frames of a block. Raises: InputError B-FRAME-032."""
        for name, batch in messages.items():
            try:
                if name not in self._writers:
                    self._writers[name] = (self._parquet_writer if self._parquet else self._csv_writer)(name, batch)
                if len(batch):
                    self._writers[name](batch)
            except OSError as failed:
                raise _unwritten(failed, self.paths[name]) from failed

    def _csv_writer(self, name: str, batch: MessageBatch) -> Write:
        path = _part(self.paths[name])
        stream = self._open.enter_context(path.open("w", newline="", encoding="utf-8"))
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([title for title, _ in self._columns(batch, slice(0, 0))])

        def write(batch: MessageBatch) -> None:
            for start in range(0, len(batch), _ROWS_AT_ONCE):
                part = slice(start, start + _ROWS_AT_ONCE)
                writer.writerows(zip(*(_texts(values) for _, values in self._columns(batch, part)), strict=True))

        return write

    def _parquet_writer(self, name: str, batch: MessageBatch) -> Write:
        import pyarrow
        from pyarrow import parquet

        kinds = {title: values.dtype for title, values in self._columns(batch, slice(0, 0))}
        is_text = {item.name for item in batch.message.fields if item.is_text}
        types = [
            (title, pyarrow.from_numpy_dtype(kind) if not kind.hasobject
             else pyarrow.string() if title in is_text else pyarrow.binary())
            for title, kind in kinds.items()
        ]  # fmt: skip
        schema = pyarrow.schema(types)
        writer = self._open.enter_context(parquet.ParquetWriter(_part(self.paths[name]), schema))
        pending: list[Any] = []

        def flush() -> None:
            if pending:
                writer.write_table(pyarrow.concat_tables(pending))
                pending.clear()

        self._open.callback(flush)

        def write(batch: MessageBatch) -> None:
            arrays = map(
                partial(_arrow, pyarrow), (values for _, values in self._columns(batch, slice(None))), schema.types
            )
            pending.append(pyarrow.Table.from_arrays(list(arrays), schema=schema))
            if sum(len(table) for table in pending) >= _ROWS_OF_A_GROUP:
                flush()

        return write

    def _columns(self, batch: MessageBatch, part: slice) -> Iterator[tuple[str, Array]]:
        """Yield title and values of each column; text and bytes are objects; what is not there is masked."""
        yield OFFSET, batch.offset[part]
        for item in batch.message.fields:
            if item.constant is None:
                yield from self._of_field(batch, item, part)

    def _of_field(self, batch: MessageBatch, item: Field, part: slice) -> Iterator[tuple[str, Array]]:
        for name, unit, values in cells_of(batch, item, part):
            empty = self._lines and values.dtype.kind == "f" and not np.ma.isMaskedArray(values)
            title = f"{name} [{unit}]" if unit else name
            yield title, np.ma.masked_invalid(values) if empty else values


def _part(path: Path) -> Path:
    """Return what is written until a table is whole, beside the file that a link leads to; a device is itself."""
    if path.exists() and not path.is_file():
        return path
    target = path.resolve()
    return target.with_name(f"{target.name}.part")


def _unwritten(error: OSError, path: Path) -> InputError:
    return InputError("B-FRAME-032", f"cannot be written: {error.strerror or error}", where=str(path))


def _whole(raw: Array, is_text: bool) -> Array:
    """Return the bytes of each frame as one object; text without the zeros behind it."""
    values = np.empty(len(raw), object)
    whole = map(bytes, raw)
    values[:] = list(map(_text, whole)) if is_text else list(whole)
    return values


def _text(raw: bytes) -> str:
    """Return characters; what cannot be printed as it is written in Python."""
    text = raw.rstrip(b"\0").decode("ascii", "backslashreplace")
    return "".join(char if char.isprintable() else f"\\x{ord(char):02x}" for char in text)


def _texts(values: Array) -> list[Any]:
    """Return values as CSV has them; floats in the fewest digits that give the same number back, bytes as hex."""
    if values.dtype == object:
        return [value.hex() if isinstance(value, bytes) else value for value in values.tolist()]
    return list((values.astype(str) if values.dtype == np.float32 else values).tolist())


def _arrow(pyarrow: Any, values: Array, kind: Any) -> Any:
    if values.dtype == object:
        return pyarrow.array(values.tolist(), kind)
    return pyarrow.array(np.ma.getdata(values), kind, mask=np.ma.getmaskarray(values))
