"""Tokens of the page: made by chance, told once, kept hashed in a file that only its owner may read.

The file is ``serve.json`` in ``$XDG_CONFIG_HOME/inertial-bench`` (``~/.config/inertial-bench``), mode 0600. It holds a
salt, the SHA-256 of salt and token for each role, and the key that signs cookies. A token has 192 random bits, so a
plain hash is enough: nobody tries 2**192 of them. Wrong ones may be tried a few times a minute. The only file of the
project that draws without a seed.
"""

from __future__ import annotations

import hashlib
import hmac
import json
import os
import secrets
import stat
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path

from bench.model.clock import NS, Clock
from bench.model.errors import InputError
from bench.model.posix import NO_LINK, is_own

VIEWER, OPERATOR, BENCH = "viewer", "operator", "bench"
ROLES = (VIEWER, OPERATOR, BENCH)
FILE = "serve.json"
TOKEN_BYTES = 24
_OTHERS_USE = stat.S_IRWXG | stat.S_IRWXO
WINDOW_S = 60
MOST_OF_ADDRESS = 5
MOST_IN_ALL = 30


@dataclass(frozen=True)
class Tokens:
    """The tokens as they are kept; hexadecimal."""

    salt: str
    viewer: str
    operator: str
    bench: str
    cookie_key: str

    def role_of(self, token: str) -> str | None:
        """Return role that a token opens, None for a wrong one; takes as long whatever the token is."""
        given = _hash(self.salt, token)
        fits = {role: hmac.compare_digest(given, getattr(self, role)) for role in ROLES}
        return next((role for role in ROLES if fits[role]), None)


def private_folder() -> Path:
    """Return where the tokens and the audit of the page are kept."""
    base = os.environ.get("XDG_CONFIG_HOME", "")
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".config") / "inertial-bench"


def draw_id() -> str:
    """Return 16 hexadecimal digits that nobody guesses: the name of one login."""
    return secrets.token_hex(8)


def obtain_tokens(folder: Path, rotate: bool = False) -> tuple[Tokens, dict[str, str]]:
    """Return tokens in ``folder``, made if there are none or ``rotate``; and the new ones in clear by role, else {}.

    Raises: InputError B-WEB-006 if others may read the file or change the folder, B-WEB-007 if the file cannot be
    read, written or understood.
    """
    path = folder / FILE
    try:
        for place in (folder.parent, folder):  # made for everybody, ~/.config would let others change what is in it
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
        _refuse_open_folder(folder)
        if not rotate and os.path.lexists(path):
            return _kept(path)
        clear = {role: secrets.token_urlsafe(TOKEN_BYTES) for role in ROLES}
        salt = secrets.token_hex(16)
        hashes = {role: _hash(salt, token) for role, token in clear.items()}
        made = Tokens(salt=salt, cookie_key=secrets.token_hex(32), **hashes)
        return (made, clear) if _write(path, made, rotate) else _kept(path)
    except OSError as error:
        raise _unusable(path, error.strerror or str(error)) from error


def _hash(salt: str, token: str) -> str:
    return hashlib.sha256(f"{salt}:{token}".encode("utf-8", "surrogatepass")).hexdigest()


def _write(path: Path, tokens: Tokens, replace: bool) -> bool:
    """Write the whole file at once; False if another server was first."""
    draft = path.with_name(f".{FILE}.{secrets.token_hex(4)}")
    descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            json.dump({"schema": 1, **asdict(tokens)}, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        if replace:
            draft.replace(path)
            return True
        try:
            os.link(draft, path)
        except FileExistsError:
            return False
        return True
    finally:
        draft.unlink(missing_ok=True)


def _kept(path: Path) -> tuple[Tokens, dict[str, str]]:
    """Return the tokens of a file; one of an earlier version, without the bench's, gets it, which is told in clear."""
    clear = {BENCH: secrets.token_urlsafe(TOKEN_BYTES)}
    tokens, is_whole = _read(path, clear[BENCH])
    if is_whole:
        return tokens, {}
    _write(path, tokens, replace=True)
    return tokens, clear


def _read(path: Path, bench_token: str) -> tuple[Tokens, bool]:
    """Return the tokens of a file, and whether that of the bench, else ``bench_token``, is among them."""
    with os.fdopen(os.open(path, os.O_RDONLY | NO_LINK), encoding="utf-8") as file:
        status = os.fstat(file.fileno())
        if not is_own(status, _OTHERS_USE):
            message = (
                f"the file of the tokens has mode {stat.S_IMODE(status.st_mode):04o}, others may use it; due: 0600"
            )
            advice = "'chmod 600' it if nobody has read it, else 'bench serve --rotate' makes new tokens"
            raise InputError("B-WEB-006", message, where=path, next_step=advice)
        try:
            kept = {**json.load(file)}
            is_whole = BENCH in kept
            if not is_whole:
                kept[BENCH] = _hash(kept["salt"], bench_token)
            return Tokens(**{name: _hexadecimal(kept[name]) for name in Tokens.__dataclass_fields__}), is_whole
        except (ValueError, KeyError, TypeError) as error:
            raise _unusable(path, f"not what 'bench serve' wrote ({error})") from error


def _hexadecimal(text: str) -> str:
    if len(bytes.fromhex(text)) < 16:
        raise ValueError("too short")
    return text


def _refuse_open_folder(folder: Path) -> None:
    if not is_own(folder.stat()):
        message = "others may change what is in this folder, which keeps the tokens of the page"
        raise InputError("B-WEB-006", message, where=folder, next_step="'chmod 700' it, as its owner")


def _unusable(path: Path, why: str) -> InputError:
    advice = "'bench serve --rotate' makes new tokens; check the folder and $XDG_CONFIG_HOME"
    return InputError("B-WEB-007", f"the tokens of the page cannot be kept here: {why}", where=path, next_step=advice)


class LoginLimit:
    """Counts failures of the last minute, by address and in all; holds at most ``MOST_IN_ALL`` of them."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._failures: deque[tuple[int, str]] = deque(maxlen=MOST_IN_ALL)

    def wait_s(self, address: str) -> int:
        """Return seconds until this address may try again, 0 for now."""
        now_ns = self._clock.now_ns()
        while self._failures and now_ns - self._failures[0][0] > WINDOW_S * NS:
            self._failures.popleft()
        own = [t_ns for t_ns, who in self._failures if who == address]
        times = [t_ns for t_ns, _ in self._failures]
        until = [
            failures[-most]
            for failures, most in ((own, MOST_OF_ADDRESS), (times, MOST_IN_ALL))
            if len(failures) >= most
        ]
        return max((1 + int(WINDOW_S - (now_ns - t_ns) / NS) for t_ns in until), default=0)

    def failed(self, address: str) -> None:
        """A wrong token came from this address."""
        self._failures.append((self._clock.now_ns(), address))
