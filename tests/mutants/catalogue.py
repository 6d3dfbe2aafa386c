"""Mistakes that must not pass: each is put into a copy of the product, and the tests named for it must fail.

They stand in ``catalogue.toml``. The tests of a mutant take a few seconds at most; that others catch it too does not
matter here.
"""

import csv
import tomllib
from pathlib import Path
from typing import NamedTuple


class Mutant(NamedTuple):
    """A mistake: in a file, ``old`` (which stands there once) becomes ``new``; ``tests`` are those that notice it."""

    name: str
    file: str
    old: str
    new: str
    tests: list[str]


HERE = Path(__file__).parent
MUTANTS = [Mutant(**row) for row in tomllib.loads((HERE / "catalogue.toml").read_text(encoding="utf-8"))["mutant"]]

# Evidence that is not heard, as if its threshold were never reached; evidence.csv: the test that then finds too little.
MUTANTS += [
    Mutant(
        f"evidence {row['code']} is not heard",
        "bench/analysis/doubt.py",
        "    heard = list(evidence)\n",
        f"    heard = [seen for seen in evidence if seen.code != {row['code']!r}]\n",
        [row["test"]],
    )
    for row in csv.DictReader((HERE / "evidence.csv").read_text(encoding="utf-8").splitlines())
]
