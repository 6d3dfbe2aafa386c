"""The temperature that the unit reports over one of its links."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager

import numpy as np
from numpy.typing import NDArray

from bench.frame import LinkBatch
from bench.plan import PlannedUnit
from bench.run.links.reader import LinkReader

TEMPERATURE = "unit_temperature"


def thermometer(readers: Mapping[str, LinkReader]) -> tuple[LinkReader | None, str]:
    """Return the link and the message that carry the temperature of the unit; None if there is none."""
    for reader in readers.values():
        for message in reader.definition.layout.messages:
            if TEMPERATURE in message.by_name:
                return reader, message.name
    return None, ""


def of_unit(readers: Mapping[str, LinkReader], unit: PlannedUnit | None) -> Mapping[str, LinkReader]:
    """Return the links of a unit, all of them for None."""
    return readers if unit is None else {name: readers[name] for name in readers if name in unit.names}


@contextmanager
def hearing(
    lock: AbstractContextManager[object],
    readers: Mapping[str, LinkReader],
    heard: Callable[[NDArray[np.int64], NDArray[np.float64]], None],
    of: PlannedUnit | None = None,
) -> Iterator[None]:
    """Hand over every temperature that the unit reports meanwhile, on the thread that decodes: receive stamps, ns, and
    means of its sensors, degC, (n,) each. ``lock``: keeps other threads from decoding. ``of``: which unit of several.
    """
    reader, message = thermometer(of_unit(readers, of))

    def listen(batch: LinkBatch) -> None:
        frames = batch.messages.get(message)
        if frames is not None and len(frames) and frames.t_ns is not None:
            column = frames.scaled(TEMPERATURE)
            good = ~frames.suspect
            heard(frames.t_ns[good], (column if column.ndim == 1 else column.mean(axis=1))[good])

    if reader is not None:
        with lock:
            reader.listeners.append(listen)
    try:
        yield
    finally:
        if reader is not None:
            with lock:
                reader.listeners.remove(listen)
