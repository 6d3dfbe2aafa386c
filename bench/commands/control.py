"""``bench pause``, ``abort``, ``shelve``, ``answer``, what ``bench resume`` tries first: a word with a living run."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path
from typing import Any

from bench.commands.console import say
from bench.model.errors import InputError
from bench.model.posix import unix_socket
from bench.model.units import parse_quantity
from bench.run.control.local_socket import LONGEST_LINE, find_socket

ANSWER_S = 5.0
LONGEST_REPLY = 1_000_000
ADVICE = {
    "answer": "'bench answer SESSION VALUE' again at the bench, the value with its unit; the run goes on waiting",
    "pause": "give a short --reason, one line; 'bench abort SESSION' ends the run",
    "shelve": "'bench top SESSION' shows the alarms with their numbers",
    "resume": "'bench top SESSION' shows what the run does",
    "abort": "'bench top SESSION' shows what the run does; Ctrl-C in its own terminal or SIGTERM ends it too",
}


def ask(folder: Path, command: str, reason: str = "", **about: object) -> dict[str, Any]:
    """Send one command to the run of a session and return its reply; ``about``: what else belongs to the request.

    Raises: InputError B-CTRL-001 if no run of this session is alive, B-CTRL-002 if the run refuses the command,
    B-CTRL-003 if there is no answer in 5 s or none that is understood.
    """
    place = "afar" if os.environ.get("SSH_CONNECTION") else "bench"  # as sshd(8) says it, ENVIRONMENT
    line = json.dumps({"command": command, "reason": reason, "place": place, **about}).encode() + b"\n"
    if len(line) > LONGEST_LINE:
        raise _refused(folder, command, f"the words are too long: {len(line)} bytes, at most {LONGEST_LINE}")
    reply = _exchange(folder, line)
    if not reply.get("ok"):
        raise _refused(folder, command, str(reply.get("error", "refused")))
    return reply


def _refused(folder: Path, command: str, why: str) -> InputError:
    advice = ADVICE.get(command, "'bench top SESSION' shows what the run does")
    return InputError("B-CTRL-002", why, where=folder, next_step=advice)


def pause(folder: Path, reason: str) -> None:
    """Let a run stand still until it is resumed."""
    _passed_on(folder, "pause", reason)


def abort(folder: Path, reason: str) -> None:
    """End a run at its next check; its bench is made safe and its session closed."""
    _passed_on(folder, "abort", reason)


def shelve(folder: Path, alarm: str, duration: str, reason: str) -> None:
    """Shelve an alarm of a run for a while. Raises: InputError B-CTRL-004 for what is no duration; as ``ask``."""
    try:
        seconds = parse_quantity(duration, "s")
    except ValueError as error:
        advice = "for example --for '30 min'"
        raise InputError("B-CTRL-004", str(error), where="--for", next_step=advice) from error
    _passed_on(folder, "shelve", reason, alarm=alarm, seconds=seconds)


def answer(folder: Path, value: str) -> None:
    """Answer the prompt a run waits at. Raises: as ``ask``; B-CTRL-002 too if nothing is asked."""
    asked = ask(folder, "status").get("prompt")
    if not isinstance(asked, dict):
        advice = "'bench top' shows what the run does"
        raise InputError("B-CTRL-002", "the run asks nothing", where=folder, next_step=advice)
    say(asked["text"])
    _passed_on(folder, "answer", prompt=asked["id"], value=value or None)


def _passed_on(folder: Path, command: str, reason: str = "", **about: object) -> None:
    """Pass a command on, its reason on one line, and say what the run says to it."""
    say(ask(folder, command, " ".join(reason.split()), **about)["text"])


def release(folder: Path) -> bool:
    """Let a paused run go on; False if no run of this session is alive. Raises: as ``ask``, but not B-CTRL-001."""
    try:
        say(ask(folder, "resume")["text"])
    except InputError as error:
        if error.code == "B-CTRL-001":
            return False
        raise
    return True


def _exchange(folder: Path, line: bytes) -> dict[str, Any]:
    if not folder.is_dir():
        message = "there is no such folder"
        raise InputError("B-CTRL-001", message, where=folder, next_step="name the folder of a session")
    with _opened(folder) as connection:
        connection.settimeout(ANSWER_S)
        try:
            connection.connect(str(find_socket(folder)))
        except BlockingIOError as error:  # too many clients wait already: somebody is there
            raise _no_answer(folder, error) from error
        except OSError as error:
            raise InputError(
                "B-CTRL-001",
                f"no run of this session is alive ({error.strerror or error})",
                where=folder,
                next_step="'bench resume SESSION' goes on with a session that ended early",
            ) from error
        try:
            connection.sendall(line)
            reply = json.loads(_line(connection))
        except (OSError, ValueError) as error:
            raise _no_answer(folder, error) from error
    return reply if isinstance(reply, dict) else {}


def _opened(folder: Path) -> socket.socket:
    try:
        return unix_socket()
    except OSError as error:
        advice = "a run in real time needs Linux, and a command for it the machine it goes on at"
        raise InputError(
            "B-CTRL-001", f"no run is alive here: {error.strerror}", where=folder, next_step=advice
        ) from error


def _no_answer(folder: Path, error: Exception) -> InputError:
    advice = "try again; Ctrl-C in the run's own terminal or SIGTERM stops it as well"
    return InputError("B-CTRL-003", f"the run gave no answer ({error})", where=folder, next_step=advice)


def _line(connection: socket.socket) -> bytes:
    received = b""
    while b"\n" not in received and len(received) < LONGEST_REPLY:
        chunk = connection.recv(65536)
        if not chunk:
            break
        received += chunk
    return received
