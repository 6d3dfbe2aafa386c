"""One wrong byte anywhere in a YAML file of the repository: a clean error with its position, or a valid plan."""

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from time import process_time

import numpy as np
import pytest

from bench.frame import load_frame
from bench.model.errors import InputError, InputErrors
from bench.plan import check_plan, compile_sequence, load_station

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("sequences", "stations", "frames")
FILES = sorted(path.relative_to(ROOT) for folder in FOLDERS for path in (ROOT / folder).glob("*.yaml"))
SEQUENCES = {
    "gnc_bench_sim": "gnc_magnetometer", "fog_bench_sim": "fog_north", "rlg_bench_sim": "rlg_lock_in",
    "time_sync_bench_sim": "time_sync_turn", "af_four_units_sim": "bias_ramp_units",
}  # fmt: skip  # what a station is checked with, if not with the shortest one
SEED = 20_000_101
LARGE_BYTES, LARGE_COUNT = 20_000, 50
FRAMES_MORE = 4  # mutants of a frame, which is read in no time
LIMIT_S = 2.0
MOST_TIMES = 3.0  # a campaign of four units takes most of it as it is
POSITION = re.compile(r".+:\d+:\d+")


@pytest.fixture
def bench_folder(tmp_path: Path) -> Path:
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, tmp_path / folder)
    return tmp_path


def load(path: Path) -> None:
    """Read a file the way the bench does, up to the finished static check."""
    if path.parent.name == "frames":
        load_frame(path)
    elif path.parent.name == "stations":
        station = load_station(path)
        sequence = SEQUENCES.get(path.stem, "timeline_example")
        errors = check_plan(compile_sequence(path.parents[1] / "sequences" / f"{sequence}.yaml", station))
        if errors:
            raise InputErrors(errors)
    else:
        errors = check_plan(compile_sequence(path))
        if errors:
            raise InputErrors(errors)


def mutations(raw: bytes, count: int, rng: np.random.Generator) -> Iterator[tuple[int, int, bytes]]:
    """Flip, replace, insert or remove one byte; half of the new bytes are ones a person could type."""
    for _ in range(count):
        at, value, how = int(rng.integers(len(raw))), int(rng.integers(256)), int(rng.integers(4))
        if rng.integers(2):
            value = 0x20 + value % 0x5F
        if how == 0:
            value = raw[at] ^ (1 << (value % 8))
        yield at, value, raw[:at] + (b"" if how == 2 else bytes([value])) + raw[at + (how != 3) :]


def judge(path: Path, act: Callable[[Path], None], whole: bytes | None = None) -> str:
    """Name of the outcome; fails on anything but a plan or positioned errors in time: ``LIMIT_S``, or a few times what
    the file takes that nobody changed, ``whole``."""
    started = process_time()
    outcome = "valid"
    try:
        act(path)
    except InputError as error:
        outcome = "refused"
        for single in error.errors if isinstance(error, InputErrors) else [error]:
            assert re.fullmatch(r"B-[A-Z]+-\d{3}", single.code)
            assert POSITION.fullmatch(single.where), f"no position in {single}"
    took_s = process_time() - started
    if whole is not None and took_s >= LIMIT_S:
        path.write_bytes(whole)
        started = process_time()
        act(path)
        assert took_s < MOST_TIMES * (process_time() - started)
    else:
        assert took_s < LIMIT_S
    return outcome


@pytest.mark.slow
@pytest.mark.parametrize(("total", "least"), [(150, 30), pytest.param(10_000, 1_000, marks=pytest.mark.sweep)])
def test_one_byte_mutations(bench_folder: Path, total: int, least: int) -> None:
    rng = np.random.default_rng(SEED)
    outcomes = {"valid": 0, "refused": 0}
    share = -(-total // len(FILES))
    for name in FILES:
        path = bench_folder / name
        raw = path.read_bytes()
        count = min(share, LARGE_COUNT) if len(raw) > LARGE_BYTES else share
        count *= FRAMES_MORE if name.parent.name == "frames" else 1
        for at, value, mutant in mutations(raw, count, rng):
            path.write_bytes(mutant)
            try:
                outcomes[judge(path, load, raw)] += 1
            except Exception:
                print(f"seed {SEED}: {name} byte {at} value {value}")
                raise
        path.write_bytes(raw)
    print(f"seed {SEED}: {outcomes}")
    assert sum(outcomes.values()) >= max(total, 300)
    assert min(outcomes.values()) > least
