"""Definitions that nobody would write, drawn at random: what is encoded is decoded, and all engines agree on damage.

``make definitions`` tries 200,000 of them; BENCH_SEEDS=FIRST:LAST tries a part, so that a sweep can be resumed.
"""

import json
import os
from itertools import chain
from typing import Any

import numpy as np
import pytest
from record_sample import chunks_of
from test_frame_engines import DAMAGE, Generator, damage, everything, random_values

from bench.frame import FrameDefinition, FrameSpec, parse_frame
from bench.frame.compiling.whole import compile_frame
from bench.frame.crc import CHECKSUMS, Crc, find_model
from bench.frame.definition import encode_frame
from bench.frame.packets import ESCAPES
from bench.model.errors import InputError
from bench.model.yamlio import parse_yaml

SHORT, FULL = 250, 200_000
CHECKS = (*CHECKSUMS, "crc-8/smbus", "crc-16/modbus", "crc-16/xmodem", "crc-24q", "crc-32", "crc-64/xz", "crc-12/umts")
KINDS = ("u8", "u16", "u24", "u32", "u48", "u64", "i8", "i16", "i24", "i40", "i64", "f32", "f64")
HOLDERS = {1: "u8", 2: "u16", 3: "u24", 4: "u32", 8: "u64"}
Spec = dict[str, Any]


def one_of(choices: Any, rng: Generator) -> Any:
    return choices[int(rng.integers(len(choices)))]


def random_fields(prefix: str, rng: Generator) -> list[list[Spec]]:
    """Fields, or runs of fields that stay together."""
    fields: list[list[Spec]] = []
    for number in range(int(rng.integers(1, 6))):
        field: Spec = {"name": f"{prefix}{number}", "type": one_of((*KINDS, "bytes"), rng)}
        if field["type"] == "bytes" or rng.random() < 0.2:
            field["count"] = int(rng.integers(1, 6))
        if field["type"] != "bytes" and rng.random() < 0.3:
            field["endian"] = one_of(("big", "little"), rng)
        if field["type"] == "u8" and "count" not in field and rng.random() < 0.3:
            field["constant"] = int(rng.integers(256))
        fields.append(random_run(f"{prefix}{number}_", rng) if rng.random() < 0.15 else [field])
    return fields


def random_run(prefix: str, rng: Generator) -> list[Spec]:
    """Integers of any number of bits that end with a whole byte."""
    fields: list[Spec] = []
    bits = 0
    while bits % 8 or not fields:
        count = int(rng.integers(1, 4))
        widest = 64 - max((bits + step) % 8 for step in range(8))
        width = int(rng.integers(1, widest + 1)) if len(fields) < 4 else 8 - bits % 8
        count = count if width <= 57 and len(fields) < 4 else 1
        several = {"count": count} if count > 1 else {}
        fields.append({"name": f"{prefix}{len(fields)}", "type": f"{one_of('ui', rng)}{width}", **several})
        bits += width * count
    return fields


def framing(name: str, rng: Generator) -> tuple[Spec, str, int]:
    """A field for a length or type, what names it or its bits, and how many values these have."""
    if rng.random() < 0.5:
        kind = one_of(("u16", "u24", "u32"), rng)
        return {"name": name, "type": kind}, name, 1 << int(kind[1:])
    low = int(rng.integers(0, 6))
    high = low + int(rng.integers(9, 11))
    bits = {"stated": f"{low}-{high}", "beside": high + 1}
    return {"name": name, "type": one_of(("u24", "u32"), rng), "bits": bits}, f"{name}.stated", 1 << (high - low + 1)


def random_spec(rng: Generator) -> Spec:
    """A definition without golden frames; most parts of the language take part."""
    spec: Spec = {"frame": "random", "endian": one_of(("big", "little"), rng)}
    varies, typed = rng.random() < 0.6, rng.random() < 0.5
    spec["sync"] = rng.integers(0, 256, int(rng.integers(0 if varies else 1, 5))).tolist()
    runs = [*random_fields("common", rng), [{"name": "whole", "type": "u16"}]]
    check = one_of(CHECKS, rng)
    model = find_model(check)
    size = CHECKSUMS[check].size if model is None else Crc(model).size
    spec["crc"] = {"name": check} if check == "none" else {"name": check, "over": ["sync", "end"]}
    if size in HOLDERS and rng.random() < 0.4:
        runs.insert(int(rng.integers(len(runs) + 1)), [{"name": "check", "type": HOLDERS[size]}])
        spec["crc"]["field"] = "check"
    if varies:
        field, name, _ = framing("length", rng)
        runs.insert(int(rng.integers(len(runs) + 1)), [field])
        spec["length"] = {"field": name, "plus": 0, "times": one_of((1, 1, 2, 4), rng), "max": 900}
    if typed:
        field, name, values = framing("kind", rng)
        runs.insert(int(rng.integers(len(runs) + 1)), [field])
        spec["type"] = {"field": name}
        spec["messages"] = random_messages(values, varies, spec["length"]["times"] if varies else 1, rng)
        if varies and rng.random() < 0.5:
            spec["other"] = True
        elif rng.random() < 0.5:
            for message in spec["messages"].values():
                message["extra"] = rng.integers(0, 256, int(rng.integers(1, 4))).tolist()
    elif varies:
        runs.append([{"name": "rest", "type": "bytes", "count": "rest"}])
    if rng.random() < 0.3:
        spec["trailer"] = rng.integers(0, 256, int(rng.integers(1, 4))).tolist()
    if rng.random() < 0.15:
        spec["escape"] = one_of(("slip", "hdlc", "cobs", "dle"), rng)
    common = list(chain(*runs))
    if spec["sync"] and rng.random() < 0.15:
        spec["sync_at"] = int(rng.integers(1, 4))
        common.insert(0, {"name": "front", "type": "bytes", "count": spec["sync_at"]})
    if check != "none" and rng.random() < 0.5:
        spec["crc"]["over"][0] = common[0]["name"]
    spec["fields"] = common
    return spec


def random_messages(values: int, varies: bool, times: int, rng: Generator) -> dict[str, Spec]:
    messages: dict[str, Spec] = {}
    for number, value in enumerate(rng.choice(min(values, 4096), int(rng.integers(1, 4)), replace=False).tolist()):
        fields = list(chain(*random_fields(f"own{number}_", rng)))
        if varies:
            fields += [*random_parts(f"part{number}_", rng), {"name": "rest", "type": "bytes", "count": "rest"}]
        if varies and rng.random() < 0.2:
            fields += chain(*random_fields(f"behind{number}_", rng))
        if varies and times == 1 and rng.random() < 0.2:
            fields[fields.index({"name": "rest", "type": "bytes", "count": "rest"})] = random_items(number, rng)
        messages[f"m{number}"] = {"value": value, "fields": fields, "golden": "00", "expect": {"none": 1}}
    return messages


def bare(fields: list[list[Spec]]) -> list[Spec]:
    """Fields without what those that may be absent cannot have."""
    return [{key: value for key, value in field.items() if key != "constant"} for field in chain(*fields)]


def aligned(name: str, fields: list[Spec]) -> list[Spec]:
    """Fill up to a byte in front of floats, of integers that would lie in nine bytes, and at the end."""
    placed: list[Spec] = []
    bits = 0
    for field in [*fields, {"type": "f0"}]:
        width = int(field["type"][1:])
        if bits % 8 and (field["type"][0] == "f" or bits % 8 + width > 64):
            placed.append({"name": f"{name}_fill{len(placed)}", "type": f"u{8 - bits % 8}"})
            bits += 8 - bits % 8
        placed += [field] if width else []
        bits += width
    return placed


def random_parts(prefix: str, rng: Generator) -> list[Spec]:
    """Groups and optional parts, each with what says how often it is there."""
    parts: list[Spec] = []
    for number in range(int(rng.integers(0, 3))):
        name = f"{prefix}{number}"
        fields = bare(random_fields(f"{name}_", rng))
        if rng.random() < 0.5:
            sets = [{key: value for key, value in field.items() if key != "count"} for field in fields]
            sets = [field | {"type": "u8" if field["type"] == "bytes" else field["type"]} for field in sets]
            group = {"group": name, "count": f"{name}_n", "max": int(rng.integers(1, 6)), "fields": aligned(name, sets)}
            parts += [{"name": f"{name}_n", "type": "u8"}, group]
            continue
        flags = {"name": f"{name}_flags", "type": "u16", "bits": {"there": int(rng.integers(16))}}
        parts += [flags, {"optional": name, "when": f"{name}_flags.there", "fields": fields}]
    return parts


def random_items(number: int, rng: Generator) -> Spec:
    ids = rng.choice(256, int(rng.integers(1, 4)), replace=False).tolist()
    of: Spec = {}
    for one in ids:
        fields = bare(random_fields(f"held{number}_{one}_", rng))
        of[f"item{number}_{one}"] = {"id": one, "required": bool(rng.random() < 0.3), "fields": fields}
    kinds = {"id": one_of(("u8", "u16"), rng), "length": one_of(("u16", "u24"), rng)}
    kinds |= {"length_first": bool(rng.integers(2)), "plus": -int(rng.integers(0, 5))}
    return {"items": f"items{number}", **kinds, "of": of}


def encoded(spec: Spec, layout: Any, message: Any, rng: Generator) -> bytes:
    """A frame of a message with random values; of a length that the length field can say."""
    values = random_values(layout, message, rng)
    for _ in range(4):
        try:
            return encode_frame(layout, message, values)
        except InputError as error:
            if error.code != "B-FRAME-021" or "rest" not in values:
                raise
            values["rest"] += b"\0"
    raise AssertionError(spec)


def unescaped(layout: Any, wire: bytes) -> bytes:
    if not layout.escape:
        return wire
    piece = ESCAPES[layout.escape].next_packet(
        wire, wire[0] in (0xC0, 0x7E) and layout.escape in ("slip", "hdlc"), 9999
    )
    assert piece is not None
    assert piece.frame is not None
    return piece.frame


def with_golden(spec: Spec, rng: Generator) -> FrameDefinition:
    layout, _ = compile_frame(parse_yaml(json.dumps(spec), "random.yaml", FrameSpec))
    for message in layout.messages:
        part = spec if "messages" not in spec else spec["messages"][message.name]
        frame = encoded(spec, layout, message, rng)
        whole = message.by_name["whole"]
        plain = unescaped(layout, frame)
        value = int.from_bytes(plain[whole.offset : whole.offset + 2], "big" if whole.big else "little")
        part |= {"golden": frame.hex(), "expect": {"whole": value}}
    return parse_frame(json.dumps(spec), "random.yaml")


def compare(seed: int) -> int:
    """One definition, one sound and one damaged stream through both engines; gives the frames found in both."""
    rng = np.random.default_rng([20, seed])
    spec = random_spec(rng)
    try:
        definition = with_golden(spec, rng)
        layout, parts, order = definition.layout, [], []
        for _ in range(int(rng.integers(1, 12))):
            message = one_of(layout.messages, rng)
            order.append(message.name)
            parts.append(encoded(spec, layout, message, rng))
        stream = b"".join(parts)
        due = everything(definition, "reference", [stream])
        starts = np.cumsum([0, *map(len, parts)])[:-1] + (spec.get("escape") in ("slip", "hdlc"))
        for name in definition.messages:
            assert due[1][name] == [at for at, kind in zip(starts.tolist(), order, strict=True) if kind == name]
        assert (due[0].bad, due[0].skipped_bytes, due[0].other) == (0, 0, 0)
        broken = b"".join(bytes(damage(one_of(DAMAGE, rng), bytearray(part), layout.pattern, rng))
                          if rng.random() < 0.4 else part for part in parts)  # fmt: skip
        damaged = everything(definition, "reference", [broken])
        assert everything(definition, "numpy", chunks_of(stream, rng)) == due
        assert everything(definition, "numpy", [broken]) == damaged
        assert everything(definition, "numpy", chunks_of(broken, rng)) == damaged
    except Exception as error:
        raise AssertionError(f"seed {seed}: {json.dumps(spec)}") from error
    return due[0].frames + damaged[0].frames


def test_some_random_definitions() -> None:
    assert sum(map(compare, range(SHORT))) > 5 * SHORT


@pytest.mark.sweep
@pytest.mark.parametrize("block", range(FULL // 2000))
def test_random_definitions(block: int) -> None:
    first, last = map(int, os.environ.get("BENCH_SEEDS", f"0:{FULL}").split(":"))
    seeds = range(max(first, 2000 * block), min(last, 2000 * (block + 1)))
    print(f"seeds {seeds.start}..{seeds.stop - 1}: {sum(map(compare, seeds))} frames")
