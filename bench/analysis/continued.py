"""Records that belong together: a recording through a motion is cut in two, so that a command may stand between.

The second part says ``continues: 1``; its frames come right behind those of the first (docs/sequences.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bench.record import RecordRow, Samples

CONTINUES = "continues"


def joined(rows: Sequence[RecordRow]) -> Sequence[RecordRow]:
    """Return the same records; one that continues the record before it is part of that one.

    A record that should continue and whose frames do not follow stays alone, so that its samples are not taken for
    what they are not.
    """
    if not any(CONTINUES in row.window.conditions for row in rows):
        return rows
    found: list[RecordRow] = []
    for row in rows:
        if found and _follows(found[-1], row):
            found[-1] = _both(found[-1], row)
        else:
            found.append(row)
    return found


def _follows(before: RecordRow, row: RecordRow) -> bool:
    behind = before.window.first_counter + before.window.frames
    return bool(row.window.conditions.get(CONTINUES)) and row.window.first_counter == behind


def _both(first: RecordRow, second: RecordRow) -> RecordRow:
    window = replace(first.window, frames=first.window.frames + second.window.frames, t_end_ns=second.window.t_end_ns)
    return replace(
        first,
        window=window,
        sums={name: total + second.sums[name] for name, total in first.sums.items()},
        frames=first.frames + second.frames,
        lost=first.lost + second.lost,
        bad=first.bad + second.bad,
        quality=first.quality | second.quality,
        duplicate=first.duplicate + second.duplicate,
        suspect=first.suspect + second.suspect,
        timing={},
        samples=_samples(first.samples, second.samples),
    )


def _samples(first: Samples | None, second: Samples | None) -> Samples | None:
    if first is None or second is None:
        return None
    return replace(
        first,
        columns={name: np.concatenate((part, second.columns[name])) for name, part in first.columns.items()},
        counter=np.concatenate((first.counter, second.counter)),
        t_ns=np.concatenate((first.t_ns, second.t_ns)),
    )
