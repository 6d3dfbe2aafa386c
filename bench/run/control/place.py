"""Where the sockets of a run are: in its session's folder, or elsewhere when that path is too long for one.

Source: unix(7): sun_path holds 108 bytes with the final zero.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

CONTROL, LIVE = "control", "live"
LONGEST_PATH = 107


def socket_path(folder: Path, what: str = CONTROL) -> Path:
    """Path for a socket of a session, made short where it must be; writes ``control.path`` (``live.path``) then."""
    path = (folder / f"{what}.sock").resolve()
    if len(os.fsencode(path)) <= LONGEST_PATH:
        return path
    runtime = Path(os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()) / f"inertial-bench-{os.getuid()}"
    runtime.mkdir(mode=0o700, exist_ok=True)
    if runtime.stat().st_uid != os.getuid():
        raise PermissionError(f"{runtime} belongs to somebody else")
    path = runtime / f"{hashlib.sha256(os.fsencode(folder.resolve())).hexdigest()[:16]}.{what}.sock"
    (folder / f"{what}.path").write_text(str(path), encoding="utf-8")
    return path


def find_socket(folder: Path, what: str = CONTROL) -> Path:
    """Path of a socket of a session that may be running."""
    pointer = folder / f"{what}.path"
    return Path(pointer.read_text(encoding="utf-8")) if pointer.is_file() else folder.resolve() / f"{what}.sock"


def forget_socket(folder: Path, path: Path, what: str = CONTROL) -> None:
    """Nobody answers there any more."""
    path.unlink(missing_ok=True)
    (folder / f"{what}.path").unlink(missing_ok=True)
