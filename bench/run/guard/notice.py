"""Tells people that the guard acted: a program the guard starts when the bench is safe, so that it needs none of it.

``python -m bench.run.guard.notice NOTIFY`` with the station's section ``notify`` as JSON and the message on the
standard input; the ways are those of a run's own notifications.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable

from bench.model.posix import NOTICE, own_process
from bench.plan import Notify
from bench.run.guard.notify_ways import ATTEMPTS, Message, NotSent, ways_of


def notice_command(notify: Notify | None) -> tuple[str, ...]:
    """Return the program and its arguments; empty if nobody is told of alarms."""
    if notify is None or "alarm" not in notify.on:
        return ()
    document = notify.model_dump_json(exclude={"heartbeat"}, exclude_none=True)
    return tuple(own_process(NOTICE, document))


def main(document: str) -> int:
    """Send the message every way there is. Returns: 0, or 1 if one of them did not get through."""
    notify = Notify.model_validate_json(document)
    message = json.load(sys.stdin)
    failed = [send for _, send in ways_of(notify) if not _sent(send, message)]
    return 1 if failed else 0


def _sent(send: Callable[[Message], None], message: Message) -> bool:
    for _ in range(ATTEMPTS):
        try:
            send(message)
        except NotSent as error:
            print(error, file=sys.stderr)  # noqa: T201
        else:
            return True
    return False


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
