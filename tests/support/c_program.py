"""A C program with a header that the product has written: C99, every warning an error."""

import shutil
import subprocess
from pathlib import Path

import pytest


def compile_main(folder: Path, *how: str) -> None:
    """Compile main.c; without ``how`` into the program main."""
    compiler = shutil.which("gcc") or shutil.which("cc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler on this machine: the header is not compiled")
    words = [compiler, "-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "main.c", *(how or ("-o", "main"))]
    built = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert (built.returncode, built.stderr) == (0, "")
