"""A disk that refuses for a while does not end a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bench.model.events import Disk
from bench.record import RecordError

DISK_REFUSES = ("B-REC-001", "B-REC-005")


def patient(write: Callable[..., None], tell: Callable[[Disk], None]) -> Callable[..., None]:
    """The same call of the recorder, which goes on while the disk refuses.

    What a session was given is held until the disk takes it (B-REC-001), a line of the step journal is left out
    (B-REC-005). ``tell`` is called once per trouble. When too much is held the recorder raises B-REC-003, and that
    ends the run.
    """
    said = False

    def call(*arguments: Any) -> None:
        nonlocal said
        try:
            write(*arguments)
        except RecordError as error:
            if error.code not in DISK_REFUSES:
                raise
            if not said:
                tell(Disk(code=error.code, text=str(error)))
            said = True
        else:
            said = False

    return call
