"""Say which files a frame passes from its bytes to results.json, and a step from YAML to the journal.

Runs a short rehearsal and notes the file of every function that is called meanwhile, and how often one file calls
another. Run by ``make ways``.
"""

import json
import sys
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from statistics import median
from types import FrameType
from typing import Any

from bench.commands import run as command
from bench.model.clock import VirtualClock
from bench.run.bus.reader import LinkReader
from bench.run.sequencer import Sequencer
from bench.session import finish

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = f"{ROOT}/bench/"
SEQUENCE = "scale_factor_wall"
FRAME = [(LinkReader, name) for name in ("receive", "receive_parts", "record", "decode")]
FRAME += [(finish, name) for name in ("analyse_view", "results_json", "write_file")]
STEP = [(command, "checked_plan"), (Sequencer, "_execute")]
BESIDE = [(VirtualClock, "_run")]  # what watches and feeds while a step waits


class Walk:
    """What happens between the call of a function and its return: the files that are passed, and how often they change.

    A file is passed where one of its functions is called; going back to the caller is no change.
    """

    def __init__(self) -> None:
        self.files: set[str] = set()
        self.changes = 0
        self._last = ""

    def note(self, frame: FrameType, event: str, argument: object) -> None:
        """Take in one event of the profiler."""
        del argument
        name = frame.f_code.co_filename
        if event == "call" and frame.f_code.co_name != "<module>" and name.startswith(PRODUCT):
            self.files.add(name)
            self.changes += self._last not in ("", name)
            self._last = name


class Way:
    """The walks through some functions of the product; what another way passes meanwhile is not part of them.

    ``walks``: by the name of the function and, where it is given a step, the kind of that.
    """

    def __init__(self, places: list[tuple[Any, str]]) -> None:
        self.walks: dict[tuple[str, str], list[Walk]] = {}
        for owner, name in places:
            setattr(owner, name, self._noted(getattr(owner, name)))

    @property
    def files(self) -> list[str]:
        """Return the files of all walks, sorted, as paths in the repository."""
        files = {file for walks in self.walks.values() for walk in walks for file in walk.files}
        return sorted(file.removeprefix(f"{ROOT}/") for file in files)

    def changes(self, function: str, kind: str = "") -> float:
        """Return the median of the changes of file in the walks through a function. Raises: KeyError if none was."""
        return median(walk.changes for walk in self.walks[function, kind])

    def _noted(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def noted(*words: Any, **options: Any) -> Any:
            before, walk = sys.getprofile(), Walk()
            kind = getattr(words[-1], "kind", "") if words else ""
            self.walks.setdefault((function.__name__, kind), []).append(walk)
            sys.setprofile(walk.note)
            try:
                return function(*words, **options)
            finally:
                sys.setprofile(before)

        return noted


@dataclass(frozen=True)
class Ways:
    """Both ways of one rehearsal, and the number of its steps."""

    frame: Way
    step: Way
    steps: int

    def figures(self) -> dict[str, float]:
        """Return files of both ways and of a check; changes of file in a decode, a ``call`` and the check of a step."""
        (check,) = self.step.walks["checked_plan", ""]
        return {
            "files of a frame": len(self.frame.files),
            "files of a step": len(self.step.files),
            "files of a check": len(check.files),
            "changes in a decode": self.frame.changes("decode"),
            "changes in a call": self.step.changes("_execute", "call"),
            "changes in the check of a step": round(check.changes / self.steps, 1),
        }


def walked() -> Ways:
    """Rehearse a campaign and return the ways that were noted.

    The functions stay replaced, so this is for a process of its own. Raises: SystemExit if the campaign fails.
    """
    from bench.cli import main as bench

    frame, step = Way(FRAME), Way(STEP)
    Way(BESIDE)
    said = StringIO()
    with tempfile.TemporaryDirectory() as out, redirect_stdout(said), redirect_stderr(said):
        sys.argv = ["bench", "run", SEQUENCE, "--clock", "virtual", "--out", out]
        try:
            bench()
        except SystemExit as end:
            status = end.code
    if status:
        sys.exit(f"the rehearsal ended with status {status}:\n{said.getvalue()}")
    steps = sum(len(walks) for (function, _), walks in step.walks.items() if function == "_execute")
    return Ways(frame, step, steps)


def main(words: list[str]) -> None:
    """Print the files of both ways and the figures, with ``--json`` the figures alone."""
    ways = walked()
    if words == ["--json"]:
        sys.stdout.write(json.dumps(ways.figures()) + "\n")
        return
    names = {"a frame, from bytes to results.json": ways.frame, "a step, from YAML to the journal": ways.step}
    for name, way in names.items():
        sys.stdout.write(f"\n{name}: {len(way.files)} files\n")
        for file in way.files:
            sys.stdout.write(f"  {file}\n")
    sys.stdout.write("\n" + "".join(f"{name:30} {figure:g}\n" for name, figure in ways.figures().items()))


if __name__ == "__main__":
    main(sys.argv[1:])
