"""Which engine decodes: the kernel where its code is there and sound, else numpy with one sentence of why."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from record_sample import frame

from bench.frame import best
from bench.frame.best import kernel, kernel_path, load_kernel, why_no_kernel
from bench.frame.kernel import variant

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


@NEEDS_KERNEL
@pytest.mark.parametrize("place", [0, 40, -1])
def test_a_damaged_file_is_refused(tmp_path: Path, place: int) -> None:
    content = bytearray(kernel_path().read_bytes())
    content[place] ^= 1
    path = tmp_path / "kernel"
    path.touch(0o600)
    path.write_bytes(content)
    with pytest.raises(ValueError, match="damaged"):
        load_kernel(path)


@pytest.mark.parametrize("content", [b"", b"short", bytes(5000)])
def test_a_file_that_is_no_kernel_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "kernel"
    path.touch(0o600)
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"damaged|empty"):
        load_kernel(path)


def test_a_file_that_others_may_write_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "kernel"
    path.write_bytes(bytes(5000))
    path.chmod(0o666)
    with pytest.raises(ValueError, match="others may write it"):
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
