"""Both engines on damaged streams: identical offsets, counts and fields, whatever the chunks."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from record_sample import ROOT, chunks_of, frame

from bench.frame import FrameDefinition, LinkCounts, LinkDecoder, Message
from bench.frame.layout import Field, Layout, read_element

SHIPPED = tuple(sorted(path.stem for path in (ROOT / "frames").glob("*.yaml")))
NAMES = tuple(name for name in SHIPPED if frame(name).layout.lines is None)  # lines have one decoder only
DAMAGE = ("flip", "drop", "insert", "truncate", "repeat_tail", "garbage", "sync_storm", "false_header")
SHARES = (0.0, 0.001, 0.01, 0.1, 0.5, 1.0)
SHORT, FULL = 78, 1000
Generator = np.random.Generator


def random_values(layout: Layout, message: Message, generator: Generator) -> dict[str, Any]:
    values: dict[str, Any] = {}
    holders = (layout.length_field, layout.type_field, layout.check_field)
    framing = {item.name for item in holders if item is not None}
    framing |= {item.given.partition(".")[0] for item in message.fields}
    framing |= {one.name for part in message.parts for one in part.items}
    there: dict[str, int] = {}
    for item in message.fields:
        if item.constant is not None or item.name in framing:
            continue
        if item.given:
            most = item.count or 1 if item.step else 1
            there.setdefault(item.given, int(generator.integers(0, most + 1)))
        if not item.given or there[item.given]:
            value = random_field(item, generator)
            values[item.name] = value[0, : there[item.given]] if item.step else value
    return values


def random_field(item: Field, generator: Generator) -> Any:
    if item.rest:
        return generator.bytes(int(generator.integers(0, 80)))
    shape = (1,) if item.count is None else (1, item.count)
    if item.kind == "f":
        return generator.normal(size=shape).astype(np.float32)
    if item.kind == "b" or item.width == 64:
        size = item.length if item.kind == "b" else 8 * (item.count or 1)
        return np.frombuffer(generator.bytes(size), "u1" if item.kind == "b" else f"{item.kind}8").reshape(shape)
    if generator.random() < 0.05:
        return np.full(shape, 0xEB90 % (1 << (item.width - 1)))  # embedded sync words
    low, high = (0, 1 << item.width) if item.kind == "u" else (-(1 << item.width - 1), 1 << item.width - 1)
    return generator.integers(low, high, shape)


def damage(kind: str, frame: bytearray, pattern: bytes, generator: Generator) -> bytearray:
    at = int(generator.integers(len(frame)))
    if kind == "flip":
        frame[at] ^= 1 << int(generator.integers(8))
    elif kind == "drop":
        del frame[at : at + int(generator.integers(1, 4))]
    elif kind == "insert":
        frame[at:at] = generator.bytes(int(generator.integers(1, 4)))
    elif kind == "truncate":
        del frame[at:]
    elif kind == "repeat_tail":
        frame += frame[at:]
    elif kind == "garbage":
        frame += generator.bytes(int(generator.integers(1, 400)))
    elif kind == "sync_storm":
        frame += pattern * int(generator.integers(1, 40))
    elif kind == "false_header":
        frame[at : at + len(pattern)] = pattern
    return frame


def damaged_stream(definition: FrameDefinition, generator: Generator) -> bytes:
    stream = bytearray()
    share = SHARES[generator.integers(len(SHARES))]
    kinds = DAMAGE if generator.random() < 0.5 else (DAMAGE[generator.integers(len(DAMAGE))],)
    for _ in range(int(generator.integers(1, 90))):
        message = definition.message(definition.messages[generator.integers(len(definition.messages))])
        frame = bytearray(definition.encode_one(random_values(definition.layout, message, generator), message.name))
        if generator.random() < share:
            frame = damage(kinds[generator.integers(len(kinds))], frame, definition.layout.pattern, generator)
        stream += frame
    return bytes(stream)


def read_column(rows: NDArray[np.uint8], item: Field) -> NDArray[Any]:
    """Raw values of a field, frame by frame; same shapes, types and, of floats that are no numbers, bits as others."""
    frames = [row.tobytes() for row in rows]
    if item.kind == "f":
        begins = [item.place(element)[0] for element in range(1 if item.count is None else item.count)]
        floats = b"".join(frame[at : at + item.size] for frame in frames for at in begins)
        column = np.frombuffer(floats, f"{'>' if item.big else '<'}{item.dtype}").astype(item.dtype)
        return column if item.count is None else column.reshape(len(frames), item.count)
    if item.count is None:
        return np.array([read_element(frame, item) for frame in frames], item.dtype)
    values = [[read_element(frame, item, element) for element in range(item.count)] for frame in frames]
    return np.array(values, item.dtype).reshape(len(frames), item.count)


def everything(definition: FrameDefinition, engine: str, chunks: list[bytes]) -> tuple[LinkCounts, dict[str, Any]]:
    """All that a decoder says about a stream, in comparable form; a flush after each chunk."""
    link = LinkDecoder(definition, engine)  # type: ignore[arg-type]
    parts = []
    for chunk in chunks:
        link.push(0, chunk)
        parts.append(link.flush())
    parts.append(link.finish())
    result: dict[str, Any] = {"bad": [offset for part in parts for offset in part.bad_offset.tolist()]}
    for name in definition.messages:
        batches = [part.messages[name] for part in parts]
        result[name] = [offset for batch in batches for offset in batch.offset.tolist()]
        result[name, "suspect"] = [mark for batch in batches for mark in batch.suspect.tolist()]
        result[name, "counter"] = [
            value for batch in batches if batch.counter is not None for value in batch.counter.tolist()
        ]
        for item in definition.message(name).fields:
            by_bytes = engine == "reference" and item.kind != "b"
            columns = [read_column(batch.rows, item) if by_bytes else batch.raw(item.name) for batch in batches]
            assert len({column.dtype for column in columns}) == 1
            exact = columns[0].dtype != object
            result[name, item.name] = [value.tobytes() if exact else value for column in columns for value in column]
    return link.counts, result


def compare(seed: int) -> tuple[int, int]:
    """One random stream through both engines, whole and in chunks; gives accepted and rejected candidates."""
    generator = np.random.default_rng(seed)
    definition = frame(NAMES[seed % len(NAMES)])
    stream = damaged_stream(definition, generator)
    due = everything(definition, "reference", [stream])
    chunked = chunks_of(stream, generator)
    for engine, chunks in (("reference", chunked), ("numpy", [stream]), ("numpy", chunked)):
        found = everything(definition, engine, chunks)
        assert found[0] == due[0], f"seed {seed}, {engine}, {len(chunks)} chunks"
        assert found[1] == due[1], f"seed {seed}, {engine}, {len(chunks)} chunks"
    return due[0].frames, due[0].bad


@pytest.mark.parametrize("seeds", [range(SHORT), pytest.param(range(1000, 1000 + FULL), marks=pytest.mark.sweep)])
def test_engines_agree_on_damaged_streams(seeds: range) -> None:
    totals = np.array([compare(seed) for seed in seeds])
    print(f"seeds {seeds.start}..{seeds.stop - 1}: {totals[:, 0].sum()} accepted, {totals[:, 1].sum()} rejected")
    assert totals[:, 0].sum() > 10 * len(seeds)
    assert totals[:, 1].sum() > len(seeds)


@pytest.mark.parametrize("share", [0.0, 0.002, 0.3])
def test_engines_agree_beyond_one_block_and_one_window(share: float) -> None:
    """Thousands of frames, so that lattice, scan and the changes between them all take part."""
    generator = np.random.default_rng(77)
    definition = frame("ngu_a")
    count = 9000
    columns: dict[str, Any] = {"npp": 1, "ppp": generator.integers(0, 65536, (count, 10)), "af_clock": 3}
    columns |= {"counter": np.arange(count), "master_count": 4, "fg_count": 0xEB90EB, "status": 0}
    parts = [bytearray(row.tobytes()) for row in definition.encode(columns, count)]
    for index in np.flatnonzero(generator.random(count) < share):
        kind = DAMAGE[generator.integers(len(DAMAGE))]
        parts[index] = damage(kind, parts[index], definition.layout.pattern, generator)
    stream = b"".join(parts)
    due = everything(definition, "reference", [stream])
    assert everything(definition, "numpy", [stream]) == due
    assert everything(definition, "numpy", [stream[:300_001], stream[300_001:]]) == due


@pytest.mark.parametrize("share", [0.0, 0.002])
def test_engines_agree_on_long_runs_of_one_message_of_several(share: float) -> None:
    """Housekeeping with an answer in between now and then, cut behind frames and inside them, between all chunks."""
    generator = np.random.default_rng(78)
    definition = frame("ngu_b")
    parts = []
    for number in range(1500):
        message = definition.message("answer" if generator.random() < 0.004 else "housekeeping")
        values = random_values(definition.layout, message, generator)
        values |= {"counter": number % 65536} if message.counter else {}
        parts.append(bytearray(definition.encode_one(values, message.name)))
        if generator.random() < share:
            parts[-1] = damage(DAMAGE[generator.integers(len(DAMAGE))], parts[-1], definition.layout.pattern, generator)
    stream = b"".join(parts)
    due = everything(definition, "reference", [stream])
    assert due[0].frames > 1400
    for size in (28, 280, 1000, len(stream)):
        assert everything(definition, "numpy", [stream[at : at + size] for at in range(0, len(stream), size)]) == due


def test_a_valid_frame_that_overlaps_another_by_one_byte_is_not_taken() -> None:
    """The last check byte of the first frame is the first sync byte of the second."""
    definition = frame("ngu_b")
    tries = (definition.encode_one({"command": 1, "payload": i.to_bytes(2, "big")}, "command") for i in range(65536))
    first = next(frame for frame in tries if frame[-1] == 0xEB)
    second = definition.encode_one({"command": 2, "payload": b"xyz"}, "command")
    stream = first + second[1:] + second
    for engine in ("reference", "numpy"):
        counts, found = everything(definition, engine, [stream])
        assert found["command"] == [0, len(first) + len(second) - 1]
        assert (counts.bad, counts.skipped_bytes) == (0, len(second) - 1)
