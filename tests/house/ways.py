"""Say which files a frame passes from its bytes to results.json, and a step from YAML to the journal.

Runs a short rehearsal and notes the file of every function that is called meanwhile. Run by ``make ways``.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

from bench.commands import run as command
from bench.model.clock import VirtualClock
from bench.run.links.reader import LinkReader
from bench.run.sequencer import Sequencer
from bench.session import finish

ROOT = Path(__file__).resolve().parents[2]
PRODUCT = f"{ROOT}/bench/"
SEQUENCE = "scale_factor_wall"
FRAME = [(LinkReader, name) for name in ("receive", "receive_parts", "record", "decode")]
FRAME += [(finish, name) for name in ("analyse_view", "results_json", "write_file")]
STEP = [(command, "checked_plan"), (Sequencer, "_execute")]
BESIDE = [(VirtualClock, "_run")]  # what watches and feeds while a step waits


class Way:
    """Notes the files of the product in which something is called by its functions, and not by those of another way."""

    def __init__(self, places: list[tuple[Any, str]]) -> None:
        self.files: set[str] = set()
        for owner, name in places:
            setattr(owner, name, self._noted(getattr(owner, name)))

    def _noted(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def noted(*args: Any, **options: Any) -> Any:
            before = sys.getprofile()
            sys.setprofile(self._note)
            try:
                return function(*args, **options)
            finally:
                sys.setprofile(before)

        return noted

    def _note(self, frame: FrameType, event: str, argument: object) -> None:
        del argument
        name = frame.f_code.co_filename
        if event == "call" and frame.f_code.co_name != "<module>" and name.startswith(PRODUCT):
            self.files.add(name.removeprefix(f"{ROOT}/"))


def main() -> None:
    """Print both lists."""
    from bench.cli import main as bench

    ways = {"a frame, from bytes to results.json": Way(FRAME), "a step, from YAML to the journal": Way(STEP)}
    Way(BESIDE)
    with tempfile.TemporaryDirectory() as out:
        sys.argv = ["bench", "run", SEQUENCE, "--clock", "virtual", "--out", out]
        with suppress(SystemExit):
            bench()
    for name, way in ways.items():
        sys.stdout.write(f"\n{name}: {len(way.files)} files\n")
        for file in sorted(way.files):
            sys.stdout.write(f"  {file}\n")


if __name__ == "__main__":
    main()
