"""Write what the code of a revision makes of sessions and sequences that no command prints.

Run by the comparison in each revision: ``states FOLDER…`` writes ``live_state.json`` into sessions, the document that a
page shows of one that is over; ``plans OUT SEQUENCE…`` writes ``SEQUENCE.plan.json`` into a folder. Where the code has
neither name nor form that is expected here, the file says so.
"""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

STATE = "live_state.json"
UNAVAILABLE = "not available"


def live_state(folder: Path) -> Any:
    """Return the state document of a session that is over."""
    from bench.web.recorded.past import Past

    return Past().final(folder)


def plan_of(sequence: str) -> Any:
    """Return the steps of a sequence as they would be recorded."""
    from bench.plan import compile_sequence, plan_json

    return json.loads(plan_json(compile_sequence(sequence).steps))


def write(path: Path, made: Callable[[], Any]) -> None:
    """Write what a function returns, or why it returns nothing: names move between revisions."""
    try:
        document = made()
    except Exception as error:  # whatever it is, it belongs to the revision, and to this file alone
        document = {UNAVAILABLE: f"{type(error).__name__}: {error}"}
    path.write_text(json.dumps(document, sort_keys=True, indent=1), encoding="utf-8")


def main(what: str, *words: str) -> None:
    """Write the states of sessions or the plans of sequences."""
    if what == "states":
        for word in words:
            write(Path(word) / STATE, lambda word=word: live_state(Path(word)))
    else:
        sys.path.append(os.getcwd())  # noqa: PTH109  as an interpreter that is started with -m does
        out, *sequences = words
        for name in sequences:
            write(Path(out) / f"{Path(name).stem}.plan.json", lambda name=name: plan_of(name))


if __name__ == "__main__":
    main(*sys.argv[1:])
