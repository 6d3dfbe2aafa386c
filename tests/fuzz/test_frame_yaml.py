"""Mutilated frame files: a definition or an error with a position, nothing else."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from bench.frame import parse_frame
from bench.model.errors import InputError

FRAMES = Path(__file__).resolve().parents[2] / "frames"


def mutate(raw: bytes, generator: np.random.Generator) -> bytes:
    at = int(generator.integers(len(raw)))
    kind = int(generator.integers(4))
    byte = bytes([int(generator.choice(np.frombuffer(raw, np.uint8)))])
    if kind == 0:
        return raw[:at] + byte + raw[at + 1 :]
    if kind == 1:
        return raw[:at] + byte + raw[at:]
    if kind == 2:
        return raw[:at] + raw[at + 1 :]
    return raw[:at] + bytes([int(generator.integers(32, 127))]) + raw[at + 1 :]


def attempt(raw: bytes) -> bool:
    """Whether the text is a definition; if not, it must be refused in the proper way."""
    refusal: InputError | None = None
    try:
        parse_frame(raw.decode(), "mutant.yaml")
    except UnicodeDecodeError:
        return False
    except InputError as error:
        refusal = error
    if refusal is None:
        return True
    assert refusal.code.startswith(("B-FRAME-0", "B-YAML-0"))
    assert re.fullmatch(r"mutant\.yaml:\d+:\d+", refusal.where)
    return False


def run(seed: int, count: int) -> None:
    files = sorted(FRAMES.glob("*.yaml"))
    generator = np.random.default_rng(seed)
    accepted = sum(attempt(mutate(files[index % len(files)].read_bytes(), generator)) for index in range(count))
    print(f"seed {seed}: {accepted} of {count} mutants mean something")
    assert accepted < count


def test_mutilated_frame_files() -> None:
    run(1, 200)


@pytest.mark.sweep
def test_many_mutilated_frame_files() -> None:
    run(2, 4000)
