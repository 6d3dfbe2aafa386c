"""Logins, as signed cookies of which the server keeps only those that were ended; and the one that commands."""

from __future__ import annotations

import asyncio
import json
import os
import re
import unicodedata
from collections import Counter
from collections.abc import Container, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from itsdangerous import BadData, TimestampSigner, URLSafeTimedSerializer
from starlette.requests import cookie_parser

from bench.model.clock import NS, Clock
from bench.model.posix import NO_LINK
from bench.web.security.tokens import BENCH, ROLES, VIEWER, Tokens

VALID_S = 7 * 86_400  # longer than any run
AHEAD_S = 86_400  # a cookie may come from the future, because clocks are set back, but not from afar
NAME = re.compile(r"\w[\w .'@-]{0,38}[\w.]|\w")  # no comma, no bracket: the name becomes part of "name, role, address"
AWAY_S = 60.0
LOGOUTS = "serve.logouts"


@dataclass(frozen=True)
class Login:
    """One login of a person: ``id`` differs from login to login, ``role`` is viewer, operator, or bench: an operator
    whose page was opened at the bench."""

    name: str
    role: str
    id: str

    @property
    def may_command(self) -> bool:
        return self.role != VIEWER

    @property
    def place(self) -> str:
        """Return where commands of this login come from, by its token alone: "bench" or "afar"."""
        return "bench" if self.role == BENCH else "afar"


class LoggedOut:
    """The logins that were ended before their cookie was too old, in ``serve.logouts``: a copy of it opens nothing.

    What cannot be written is known until the server ends.
    """

    def __init__(self, folder: Path, clock: Clock) -> None:
        self._path, self._clock = folder / LOGOUTS, clock
        self._next = asyncio.Event()  # set by the next logout, which leaves another one
        self._until_s: dict[str, int] = {}
        with suppress(OSError, ValueError, TypeError):
            kept = json.loads(self._path.read_text(encoding="utf-8"))
            self._until_s = {str(login): int(until_s) for login, until_s in kept.items()}

    def add(self, login: Login) -> None:
        """End a login, and wake whoever waits for that."""
        now_s = self._clock.utc_ns() // NS
        kept = {name: until_s for name, until_s in self._until_s.items() if until_s >= now_s}
        self._until_s = {**kept, login.id: now_s + VALID_S + AHEAD_S}
        draft = self._path.with_name(f".{LOGOUTS}.draft")
        with suppress(OSError):
            descriptor = os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | NO_LINK, 0o600)
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                json.dump(self._until_s, file)
            draft.replace(self._path)
        self._next.set()
        self._next = asyncio.Event()

    async def ended(self, login: Login) -> None:
        """Return when a login has been ended; for the event loop on which ``add`` is called."""
        while login.id not in self:
            await self._next.wait()

    def __contains__(self, login_id: object) -> bool:
        return login_id in self._until_s


class Cookies:
    """Writes and reads the cookie of one server: ``name`` is that of the cookie; none of a login that was ended."""

    def __init__(self, tokens: Tokens, clock: Clock, port: int, secure: bool, logged_out: Container[str] = ()) -> None:
        class _Signer(TimestampSigner):
            """Asks the one clock of the project."""

            def get_timestamp(self) -> int:
                return clock.utc_ns() // NS

        # browsers keep cookies by host alone: the port keeps two benches apart that are reached through ssh -L
        self.name = f"{'__Host-' if secure else ''}bench_login_{port}"
        self._secure = secure
        self._clock = clock
        self._logged_out = logged_out
        self._serializer = URLSafeTimedSerializer(
            tokens.cookie_key,
            salt="login",
            signer=_Signer,
            signer_kwargs={"digest_method": sha256, "key_derivation": "hmac"},
        )

    def header(self, login: Login) -> str:
        """Return value of Set-Cookie for a login."""
        signed = self._serializer.dumps([login.name, login.role, login.id])
        return self._attributes(signed if isinstance(signed, str) else signed.decode(), VALID_S)

    def forget(self) -> str:
        """Return value of Set-Cookie that removes it."""
        return self._attributes("", 0)

    def read(self, header: str) -> Login | None:
        """Return the login in a Cookie header; None if there is none, it is not signed by us, or too old."""
        try:
            # not http.cookies, which stops at the first cookie of another program that it does not like
            content, signed = self._serializer.loads(cookie_parser(header).get(self.name, ""), return_timestamp=True)
            name, role, login_id = content
        except (BadData, ValueError, TypeError):
            return None
        age_s = self._clock.utc_ns() // NS - signed.timestamp()
        if not -AHEAD_S <= age_s <= VALID_S or role not in ROLES or login_id in self._logged_out:
            return None
        return Login(name, role, login_id)

    def _attributes(self, value: str, max_age_s: int) -> str:
        secure = "; Secure" if self._secure else ""
        return f"{self.name}={value}; Path=/; Max-Age={max_age_s}; HttpOnly; SameSite=Strict{secure}"


def clean_name(text: str) -> str | None:
    """Return a person's name as it is shown and recorded: one to 40 letters, digits, blanks and . ' @ -; else None."""
    name = " ".join(unicodedata.normalize("NFC", text).split())
    return name if NAME.fullmatch(name) else None


@dataclass(frozen=True)
class Holder:
    """The holder of the command, since when (UTC, seconds since 1970)."""

    login: Login
    since_utc_s: float


class Lease:
    """Belongs to one login; ends when the login has had no open socket for ``AWAY_S``. For one event loop."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._holder: Holder | None = None
        self._open: Counter[str] = Counter()
        self._last_seen_ns = 0

    @contextmanager
    def present(self, login: Login) -> Iterator[None]:
        """As long as this is entered, the login has an open socket."""
        self._open[login.id] += 1
        try:
            yield
        finally:
            self._open[login.id] -= 1
            if not self._open[login.id]:
                del self._open[login.id]
            if self._holder is not None and self._holder.login.id == login.id:
                self._last_seen_ns = self._clock.now_ns()

    def take(self, login: Login) -> Holder | None:
        """Give the command to ``login``; returns who had it before, if that was another login."""
        before = self.holder()
        if before is not None and before.login.id == login.id:
            return None
        self._holder = Holder(login, self._clock.utc_ns() / NS)
        self._last_seen_ns = self._clock.now_ns()
        return before

    def leave(self, login: Login) -> bool:
        """Give the command up; False if it was not this login's."""
        if not self.held_by(login):
            return False
        self._holder = None
        return True

    def held_by(self, login: Login) -> bool:
        """Return True if this login has the command."""
        holder = self.holder()
        return holder is not None and holder.login.id == login.id

    def holder(self) -> Holder | None:
        """Return who has the command now."""
        if self._holder is not None and not self._open[self._holder.login.id]:
            away_ns = self._clock.now_ns() - self._last_seen_ns
            if away_ns > AWAY_S * NS:
                self._holder = None
        return self._holder

    def document(self) -> dict[str, object] | None:
        """Return the key ``operator`` of the state document (docs/live-protocol.md)."""
        holder = self.holder()
        return None if holder is None else {"name": holder.login.name, "since_utc_s": holder.since_utc_s}
