"""Make the compiled kernel for this machine and keep it in the user's cache: ``python -m bench.frame.kernel``.

Needs the extra ``fast``; does nothing where the kernel is there and sound.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from pathlib import Path

from bench.frame.best import HASH_BYTES, NAMES, PAGE_BYTES, PLACES, kernel_path, load_kernel, why_no_kernel
from bench.frame.kernel.variant import VARIABLE, Variant, variant_here


def kernel_file(variant: Variant) -> bytes:
    """Return the content of a file for ``load_kernel``; a process can make one variant only."""
    os.environ[VARIABLE] = variant.name
    os.environ["NUMBA_CPU_NAME"], os.environ["NUMBA_CPU_FEATURES"] = variant.processor, variant.features
    from bench.frame.kernel.compiler import compiled

    places: list[int] = []
    pages = b""
    for name in NAMES:
        code, entry = compiled(name, variant)
        places += [PAGE_BYTES + len(pages), entry]
        pages += code + bytes(-len(code) % PAGE_BYTES)
    head = PLACES.pack(*places)
    rest = head + bytes(PAGE_BYTES - HASH_BYTES - len(head)) + pages
    return hashlib.sha256(rest).digest() + rest


def make_kernel(path: Path, variant: Variant) -> None:
    """Write the file, whole or not at all; older ones of the folder stay, other installations may use them."""
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    content = kernel_file(variant)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        file.write(content)
    Path(file.name).replace(path)


def main() -> int:
    """Return the exit status: 1 if the kernel could not be made."""
    if why_no_kernel():
        path = kernel_path()
        try:
            make_kernel(path, variant_here())
            load_kernel(path)
        except Exception as error:  # whatever is wrong with the compiler or the folder: numpy decodes
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            sys.stderr.write(f"the kernel could not be made: {reason}\n")
            return 1
    sys.stdout.write(f"compiled kernel: {kernel_path()}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
