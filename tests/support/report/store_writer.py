"""A process that writes calibrations into a history until it is killed."""

import functools
import os
import signal
from multiprocessing.connection import Connection
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


def write(url: str, seed: int, count: int, statement: int = 0, told: Connection | None = None) -> None:
    """Write; ``told`` hears when it begins. Before ``statement``, if it is not 0, this process kills itself."""
    documents = every_document(seed, count)
    if statement:
        die_at(statement)
    if told is not None:
        told.send("ready")
    for document, manifest, report in documents:
        record_calibration(url, document, manifest, report)
