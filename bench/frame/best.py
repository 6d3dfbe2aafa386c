"""Which engine decodes and encodes: the compiled kernel where it can be had, else numpy; and how the kernel is loaded.

The kernel is machine code that is made once after an installation (``python -m bench.frame.kernel``) and kept in the
user's cache. To load it takes about a millisecond and neither numba nor a compiler. The name of the file carries a hash
of the source, so a newer bench never runs older code, and the file carries a hash of the code.

Format: SHA-256 of all that follows; of each function its place in the file and its entry behind that, both uint64 in
little-endian order; the functions, each from a page on.
"""

from __future__ import annotations

import ctypes
import hashlib
import mmap
import os
import platform
import struct
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from bench.frame.kernel.variant import variant_here
from bench.model.posix import is_own

Engine = Literal["kernel", "numpy", "reference"]
PAGE_BYTES = 4096
HASH_BYTES = 32
NAMES = ("decode", "encode", "count_quanta")
PLACES = struct.Struct(f"<{2 * len(NAMES)}Q")
_INSTEAD = "frames are decoded by numpy"
_ADVICE = "make it with 'python -m bench.frame.kernel', which needs the extra 'fast'"


class Kernel(NamedTuple):
    """The compiled functions (bench.frame.kernel.scan, .pack, .quanta); the memory of their code, which must stay.

    They take, before their arguments, a pointer to eight bytes that they may write and one to nothing.
    """

    decode: Callable[..., Any]
    encode: Callable[..., Any]
    count_quanta: Callable[..., Any]
    code: mmap.mmap


def best_engine() -> Engine:
    """Return the engine that decodes."""
    return "numpy" if kernel() is None else "kernel"


def kernel() -> Kernel | None:
    """Return the compiled kernel, None if it cannot be had."""
    return _loaded()[0]


def why_no_kernel() -> str:
    """Return why there is no kernel, "" if there is one."""
    return _loaded()[1]


@cache
def _loaded() -> tuple[Kernel | None, str]:
    if (sys.platform, platform.machine(), sys.implementation.name) != ("linux", "x86_64", "cpython"):
        return None, f"there is no compiled kernel for this machine: {_INSTEAD}"
    path = None
    try:
        path = kernel_path()
        return load_kernel(path), ""
    except FileNotFoundError:
        return None, f"the compiled kernel is not made yet ({_ADVICE}): {_INSTEAD}"
    except (OSError, ValueError, RuntimeError) as error:  # also where nobody has a home
        return None, f"the compiled kernel cannot be loaded from {path} ({error}; {_ADVICE}): {_INSTEAD}"


def load_kernel(path: Path) -> Kernel:
    """Map a file of machine code into memory.

    Raises: OSError; ValueError if it is damaged, or if others than its owner, this user or root, may write it.
    """
    with path.open("rb") as file:
        state = os.fstat(file.fileno())
        if not is_own(state, or_of_root=True):
            raise ValueError("others may write it")
        code = mmap.mmap(file.fileno(), 0, mmap.MAP_PRIVATE, mmap.PROT_READ | mmap.PROT_EXEC)
    view = memoryview(code)
    if hashlib.sha256(view[HASH_BYTES:]).digest() != view[:HASH_BYTES]:
        raise ValueError("it is damaged")
    base = int(np.frombuffer(code, np.uint8).ctypes.data)
    places = PLACES.unpack_from(code, HASH_BYTES)
    entries = [base + place + entry for place, entry in zip(places[::2], places[1::2], strict=True)]
    # no argument types: each would cost three times the call itself; two pointers stand before the arguments
    decode, encode, count_quanta = (ctypes.PYFUNCTYPE(None)(entry) for entry in entries)
    return Kernel(decode, encode, count_quanta, code)


def kernel_path() -> Path:
    """Return the file of the kernel for this source and this processor in the user's cache.

    Source: XDG Base Directory Specification: XDG_CACHE_HOME, else ~/.cache.
    """
    base = os.environ.get("XDG_CACHE_HOME", "")
    folder = (Path(base) if Path(base).is_absolute() else Path.home() / ".cache") / "inertial-bench"
    source = hashlib.sha256()
    for path in sorted((Path(__file__).parent / "kernel").glob("*.py")):
        source.update(path.read_bytes())
    return folder / f"kernel-{source.hexdigest()[:16]}-{variant_here().name}"
