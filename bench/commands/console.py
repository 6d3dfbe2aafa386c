"""The console of the command line: plain text where there is no terminal."""

from __future__ import annotations

import errno
import os
from typing import Any

from rich.console import Console

PLAIN_COLUMNS = 110


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Nobody reads any more: of results an error like any other; what is told beside them is lost, not the run."""
        if not self.stderr:
            raise BrokenPipeError
        self._lead_nowhere()

    def _lead_nowhere(self) -> None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())  # for what is still in the buffers

    def print(self, *words: Any, **style: Any) -> None:
        """A terminal that has hung up is one that nobody looks at: nothing is said any more, nothing fails."""
        try:
            super().print(*words, **style)
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            self._lead_nowhere()


def console(stderr: bool = False) -> Console:
    """Return the console of the command line; it falls back to plain text where there is no terminal.

    A terminal that is narrower than the tables breaks their lines; a table made to fit it would cut numbers off.
    """
    terminal = _Console(stderr=stderr, highlight=False, soft_wrap=True, markup=False, emoji=False)
    if not terminal.is_terminal:
        terminal.width = PLAIN_COLUMNS
    elif not stderr:
        terminal.width = max(terminal.width, PLAIN_COLUMNS)
    return terminal
