"""The journal of a refit: what is done is on the disk, so that whatever stops it loses and doubles nothing."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.model.errors import InputError
from bench.session.output import make_folder, write_file, writing

Row = dict[str, Any]
HEAD, JOURNAL = "trial.json", "journal.jsonl"


class TrialJournal:
    """The rows of each session that is done, in a folder that belongs to one trial.

    Args:   folder: made if it is not there.   head: what the trial is, with its ``name``.
    Raises: InputError B-ARC-006 if the folder is of another trial, B-CLI-007 if it cannot be written.
    """

    def __init__(self, folder: Path, head: Row) -> None:
        make_folder(folder)
        self._path = folder / JOURNAL
        _claim(folder / HEAD, head)
        self._places: dict[str, int] = {}
        with writing(self._path):
            self._path.touch()
            self._end = self._find()
            os.truncate(self._path, self._end)  # the line that was being written when it was stopped

    def _find(self) -> int:
        """Note where the line of each session begins; returns the end of the last whole one."""
        end = 0
        with self._path.open("rb") as stream:
            for line in stream:
                try:
                    key = json.loads(line)["session_sha256"]
                except (ValueError, KeyError, TypeError):
                    break
                if not line.endswith(b"\n"):
                    break
                self._places[key] = end
                end += len(line)
        return end

    @property
    def done(self) -> frozenset[str]:
        """The sessions that are done, by their SHA-256."""
        return frozenset(self._places)

    def add(self, key: str, rows: list[Row]) -> None:
        """Write the rows of a session, and wait until they are on the disk. Raises: InputError B-CLI-007."""
        line = json.dumps({"session_sha256": key, "rows": rows}, ensure_ascii=False, allow_nan=False) + "\n"
        raw = line.encode()
        with writing(self._path):
            try:
                with self._path.open("ab") as stream:
                    stream.write(raw)
                    stream.flush()
                    os.fsync(stream.fileno())
            except OSError:
                os.truncate(self._path, self._end)
                raise
        self._places[key] = self._end
        self._end += len(raw)

    def sessions(self) -> Iterator[list[Row]]:
        """Yield the rows of each session, by the hash of the session; one session is in memory at a time."""
        with self._path.open("rb") as stream:
            for key in sorted(self._places):
                stream.seek(self._places[key])
                rows: list[Row] = json.loads(stream.readline())["rows"]
                yield rows


def _claim(path: Path, head: Row) -> None:
    """Begin a trial in a folder, or go on with it."""
    try:
        known = json.loads(path.read_bytes())["name"]
    except FileNotFoundError:
        write_file(path, json.dumps(head, indent=1, sort_keys=True, ensure_ascii=False) + "\n")
        return
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise _other(path, "is no head of a refit") from error
    if known != head["name"]:
        raise _other(path, f"is of another refit ({known}, this is {head['name']})")


def _other(path: Path, message: str) -> InputError:
    return InputError(
        "B-ARC-006",
        f"{message}: other sessions, method, standards or software",
        where=path,
        next_step="name another folder with --to",
    )
