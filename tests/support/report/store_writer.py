"""A process that writes calibrations into a history until it is killed: store_writer.py URL SEED COUNT [STATEMENT].

With STATEMENT it kills itself when that statement, counted over the whole process, is about to be executed.
"""

from __future__ import annotations

import functools
import os
import signal
import sys
from typing import Any

import store_sample
from sqlalchemy import event
from sqlalchemy.engine import Engine

from bench.store import record_calibration


@functools.cache
def every_document(seed: int, count: int) -> list[tuple[dict[str, Any], dict[str, Any], str]]:
    """What is written: (results.json, manifest, report hash); every third session twice, with other results."""
    found = []
    for number, (document, manifest) in enumerate(store_sample.calibrations(count, 30.0, seed)):
        found.append((document, manifest, f"report {number}"))
        if number % 3 == 0:
            found.append(({**document, "method": "paper"}, manifest, f"report {number} again"))
    return found


def die_at(statement: int) -> None:
    """Kill this process before a statement is executed."""
    left = [statement]

    @event.listens_for(Engine, "before_cursor_execute")
    def count(*_: object) -> None:
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)


def main() -> None:
    url, seed, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    documents = every_document(seed, count)
    if len(sys.argv) > 4:
        die_at(int(sys.argv[4]))
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    for document, manifest, report in documents:
        record_calibration(url, document, manifest, report)
    sys.stdout.write("done\n")


if __name__ == "__main__":
    main()
