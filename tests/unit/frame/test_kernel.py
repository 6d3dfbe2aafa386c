"""The compiled kernel: which engine decodes, published values of checks, the same arrays and bytes as numpy."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import crccheck.crc
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from record_sample import ROOT, frame

from bench.frame import FrameDefinition, LinkDecoder, Message, MessageBatch, best, parse_frame, why_no_kernel
from bench.frame.best import kernel, kernel_path, load_kernel
from bench.frame.catalogue import CATALOGUE, CrcModel
from bench.frame.crc import Check, Crc
from bench.frame.encode import encode_rows
from bench.frame.kernel import variant
from bench.frame.kernel.arrays import FOLDED_FROM, FOLDED_WORDS, arrays_of, holds
from bench.frame.kernel_encoder import KernelEncoder
from bench.frame.layout import Field, Layout
from bench.model.errors import InputError

LOOK = """
import json, sys
from bench.frame import best_engine, why_no_kernel
print(json.dumps([best_engine(), why_no_kernel(), "numba" in sys.modules]))
"""
NEEDS_KERNEL = pytest.mark.skipif(bool(why_no_kernel()), reason=why_no_kernel() or "the kernel is there")


def looked(cache: Path) -> tuple[str, str, bool]:
    """Ask a fresh process for the engine, why there is no kernel, and whether it has loaded numba."""
    around = os.environ | {"XDG_CACHE_HOME": str(cache)}
    done = subprocess.run([sys.executable, "-c", LOOK], env=around, capture_output=True, text=True, check=True)
    engine, why, compiler = json.loads(done.stdout)
    return engine, why, compiler


def test_where_no_kernel_was_made_numpy_decodes_and_one_sentence_says_how_to_make_it(tmp_path: Path) -> None:
    engine, why, _ = looked(tmp_path)
    assert engine == "numpy"
    assert "python -m bench.frame.kernel" in why
    assert "\n" not in why
    assert list(tmp_path.iterdir()) == []


@NEEDS_KERNEL
def test_the_kernel_is_loaded_without_the_compiler() -> None:
    assert looked(kernel_path().parents[1]) == ("kernel", "", False)


def damaged(place: int) -> bytes:
    content = bytearray(kernel_path().read_bytes())
    content[place] ^= 1
    return bytes(content)


@pytest.mark.parametrize(
    ("content", "mode", "why"),
    [
        *(pytest.param(place, 0o600, "damaged", marks=NEEDS_KERNEL) for place in (0, 40, -1)),
        *((content, 0o600, r"damaged|empty") for content in (b"", b"short", bytes(5000))),
        (bytes(5000), 0o666, "others may write it"),
    ],
)
def test_a_file_that_is_no_sound_own_kernel_is_refused(
    tmp_path: Path, content: bytes | int, mode: int, why: str
) -> None:
    path = tmp_path / "kernel"
    path.write_bytes(content if isinstance(content, bytes) else damaged(content))
    path.chmod(mode)
    with pytest.raises(ValueError, match=why):
        load_kernel(path)


def test_a_kernel_that_cannot_be_loaded_is_told_with_its_file(tmp_path: Path) -> None:
    around = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    where = "from bench.frame.best import kernel_path; print(kernel_path())"
    done = subprocess.run([sys.executable, "-c", where], env=around, capture_output=True, text=True, check=True)
    path = Path(done.stdout.strip())
    path.parent.mkdir()
    path.write_bytes(b"no code")
    engine, why, _ = looked(tmp_path)
    assert engine == "numpy"
    assert f"cannot be loaded from {path}" in why


def test_without_a_kernel_the_same_calls_go_to_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(best, "_loaded", lambda: (None, "not today"))
    assert best.best_engine() == "numpy"
    assert type(frame("ngu_a").decoder("kernel")).__name__ == "NumpyDecoder"
    assert type(frame("ngu_a").decoder()).__name__ == "NumpyDecoder"
    assert kernel() is None


def test_a_processor_without_carry_less_products_gets_code_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(variant.Path, "read_text", lambda self, **how: "flags\t: fpu sse sse2 avx2 bmi1 bmi2\n")
    assert variant.variant_here() == variant.PLAIN
    assert kernel_path().name.endswith("-plain")


SHIPPED = sorted(path.stem for path in (ROOT / "frames").glob("*.yaml") if holds(frame(path.stem).layout))
ORACLES = {kind._names[0].lower(): kind for kind in crccheck.crc.ALLCRCCLASSES}
SEED = 2705


def sealed(check: Check, rows: np.ndarray, folded: bool = True) -> list[int]:
    """Return the checks of the rows (n, length) uint8 by the kernel; not ``folded``: as on other processors."""
    compiled, length = kernel(), rows.shape[1]
    assert compiled is not None
    message = Message(
        "frame", (Field("payload", "b", 1, length, 1, False),), 1 + length, 1 + length + check.size, 1, None
    )
    layout = Layout(b"\x01", b"\x01", 1, (message,), check, True, None, 0, message.length, None, False, None)
    arrays = arrays_of(layout)
    if not folded:
        arrays.numbers[FOLDED_FROM] = 1 << 40
    whole = KernelEncoder(layout, message, arrays, compiled.encode).rows({"payload": rows}, len(rows))
    assert whole is not None
    return [int.from_bytes(row[1 + length :].tobytes(), "big") for row in whole]


@NEEDS_KERNEL
@pytest.mark.parametrize("folded", [True, False])
@pytest.mark.parametrize("name", CATALOGUE)
def test_published_check_value_and_random_messages(name: str, folded: bool) -> None:
    generator, crc = np.random.default_rng(SEED), Crc(CATALOGUE[name])
    assert sealed(crc, np.frombuffer(b"123456789", np.uint8)[None, :], folded) == [CATALOGUE[name].check]
    for length in (1, 7, 8, 9, 16, 53, 8 * FOLDED_WORDS + 13):
        rows = generator.integers(0, 256, (2, length), dtype=np.uint8)
        assert sealed(crc, rows, folded) == [ORACLES[name].calc(row.tobytes()) for row in rows]


@NEEDS_KERNEL
@settings(max_examples=60, deadline=None)
@given(width=st.integers(1, 64), parameters=st.tuples(*[st.integers(0, (1 << 64) - 1)] * 3),
       turns=st.tuples(st.booleans(), st.booleans()), message=st.binary(min_size=1, max_size=300))  # fmt: skip
def test_any_parameters(width: int, parameters: tuple[int, int, int], turns: tuple[bool, bool], message: bytes) -> None:
    poly, init, xorout = (value & ((1 << width) - 1) for value in parameters)
    poly = poly or 1
    rows = np.frombuffer(message, np.uint8)[None, :]
    crc = Crc(CrcModel("any", width, poly, init, *turns, xorout))
    assert sealed(crc, rows) == sealed(crc, rows, folded=False) == crc.of_rows(rows).tolist()
    if poly & 1:
        assert sealed(crc, rows) == [crccheck.crc.Crc(width, poly, init, *turns, xorout).calc(message)]


def columns_of(definition: FrameDefinition, message: Message, count: int) -> dict[str, Any]:
    """Seeded contents of frames of a message of fixed length."""
    generator = np.random.default_rng(SEED)
    framing = {item.name for item in (definition.layout.length_field, definition.layout.type_field) if item}
    columns: dict[str, Any] = {}
    for item in message.fields:
        if item.constant is None and item.name not in framing and not item.rest:
            packed = generator.bytes(count * item.length)
            shape = (count,) if item.count is None else (count, item.count)
            kind = f"{'u' if item.kind == 'b' else item.kind}{np.dtype(item.dtype).itemsize}"
            if item.kind == "f" or item.size == np.dtype(item.dtype).itemsize:
                columns[item.name] = np.frombuffer(packed, kind).reshape(shape)
            else:
                columns[item.name] = generator.integers(0, 1 << (8 * item.size - 1), shape)
    return columns


def same(one: MessageBatch, other: MessageBatch) -> None:
    for name in ("offset", "rows", "suspect", "counter", "t_ns"):
        left, right = getattr(one, name), getattr(other, name)
        assert (left is None) == (right is None), name
        if left is not None:
            assert left.dtype == right.dtype
            assert left.tobytes() == right.tobytes(), name
    assert one.rest == other.rest
    for item in one.message.fields:
        left, right = one.raw(item.name), other.raw(item.name)
        assert (left.dtype, left.shape) == (right.dtype, right.shape)
        assert left.tolist() == right.tolist() if item.rest else left.tobytes() == right.tobytes(), item.name


@NEEDS_KERNEL
@pytest.mark.parametrize("name", SHIPPED)
def test_the_encoder_writes_the_same_bytes(name: str) -> None:
    definition = frame(name)
    for message in definition.layout.messages:
        if message.length:
            columns = columns_of(definition, message, 40)
            plain = encode_rows(definition.layout, message, columns, 40)
            assert plain.tobytes() == definition.encode(columns, 40, message.name).tobytes()
            shared = {key: column[0] for key, column in columns.items()}  # one value for all frames
            plain = encode_rows(definition.layout, message, shared, 3)
            assert plain.tobytes() == definition.encode(shared, 3, message.name).tobytes()


@NEEDS_KERNEL
@pytest.mark.parametrize("kind", ["u2", "i4", "i8", "u8", ">i4", "f8"])
def test_values_of_every_type_are_taken_or_refused_as_by_numpy(kind: str) -> None:
    """Both ends of what the fields hold, by types that hold more or less, and in more frames than a stage has."""
    definition = parse_frame(TYPES, "types.yaml")
    message, count = definition.message(), 5000
    ends = {"narrow": (0, 255), "odd": (0, (1 << 24) - 1), "signed": (-(1 << 23), (1 << 23) - 1), "wide": (0, 1 << 31)}
    for name, limits in ends.items():
        for value in {*limits, limits[0] - 1, limits[1] + 1, -1, 1 << 32}:
            wanted = np.int64(value).astype(kind)
            columns: dict[str, Any] = {**dict.fromkeys(ends, 1), name: np.full(count, wanted)}
            answers: list[bytes | str] = []
            for encode in (definition.encode, partial(encode_rows, definition.layout, message)):
                try:
                    answers.append(encode(columns, count).tobytes())
                except InputError as error:
                    answers.append(str(error))
            assert answers[0] == answers[1], (name, value)


@NEEDS_KERNEL
@settings(max_examples=150, deadline=None)
@given(size=st.sampled_from([1, 2]), wrap=st.sampled_from([None, 16, 128]), rate=st.sampled_from([None, 10.0, 100.0]),
       moves=st.lists(st.tuples(st.integers(-80, 300) | st.integers(0, 70_000), st.integers(0, 5 * 10**8)),
                      min_size=1, max_size=60),
       flushes=st.sets(st.integers(0, 60)), shared=st.booleans())  # fmt: skip
def test_counters_and_stamps_are_those_of_numpy(
    size: int, wrap: int | None, rate: float | None, moves: list[tuple[int, int]], flushes: set[int], shared: bool
) -> None:
    """Frames of two messages whose counters jump, in chunks that hold parts of frames, several of them in a flush."""
    definition = counting(size, wrap, rate, shared)
    most = wrap or 1 << (8 * size)
    raw = (np.cumsum([step if step % 3 else 1 for step, _ in moves]) % most).tolist()
    frames = [definition.encode_one({"count": value}, "AB"[index % 2]) for index, value in enumerate(raw)]
    stamps = np.cumsum([pause if pause % 2 else 0 for _, pause in moves]).tolist()
    stream, cut = b"".join(frames), 5
    links = [LinkDecoder(definition, "kernel"), LinkDecoder(definition, "numpy")]
    for index, at in enumerate(range(0, len(stream), cut)):
        for link in links:
            link.push(stamps[min(index, len(stamps) - 1)], stream[at : at + cut])
        if index in flushes or at + cut >= len(stream):
            one, other = (link.flush() for link in links)
            assert (one.lost, one.duplicate) == (other.lost, other.duplicate)
            for message in definition.messages:
                same(one.messages[message], other.messages[message])
    assert links[0].counts == links[1].counts


def counting(size: int, wrap: int | None, rate: float | None, shared: bool) -> FrameDefinition:
    """Two messages of different lengths that count together, or each on its own."""
    more = "" if wrap is None or wrap >= 1 << (8 * size) else f", wrap: {wrap}"
    field = f"{{name: count, type: u{8 * size}, role: counter{more}}}"
    heads = {"A": b"\x01", "B": b"\x02"}
    messages = []
    for name, (head, extra) in zip("AB", ((1, ""), (2, ", {name: pad, type: u16, default: 7}")), strict=True):
        body = heads[name] + bytes(size) + (bytes([0, 7]) if extra else b"")
        check = crccheck.crc.Crc8Smbus.calc(body)
        fields = (f"[{field}{extra}]" if not shared else f"[{extra.removeprefix(', ')}]").replace("[]", "[]")
        golden = (b"\xa5\x5a" + body + bytes([check])).hex()
        messages.append(f"  {name}: {{value: {head}, fields: {fields}, golden: '{golden}', expect: {{count: 0}}}}")
    common = f", {field}" if shared else ""
    speed = "" if rate is None else f"rate: {rate} Hz\n"
    return parse_frame(
        f"frame: counting\nendian: big\nsync: [0xA5, 0x5A]\n{speed}fields: [{{name: kind, type: u8}}{common}]\n"
        "type: {field: kind}\ncrc: {name: crc-8/smbus, over: [kind, end]}\nmessages:\n" + "\n".join(messages) + "\n",
        "counting.yaml",
    )


TYPES = """frame: types
endian: big
sync: [0xA5]
fields:
  - {name: narrow, type: u8}
  - {name: odd, type: u24}
  - {name: signed, type: i24, endian: little}
  - {name: wide, type: u32, endian: little}
crc: {name: xor-8, over: [narrow, end]}
golden: "a5 07 000000 000000 00000000 07"
expect: {narrow: 7}
"""
