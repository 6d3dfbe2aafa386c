"""Who is logged in, as a signed cookie: nothing of it is kept by the server, so it survives a restart."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from hashlib import sha256

from itsdangerous import BadData, TimestampSigner, URLSafeTimedSerializer
from starlette.requests import cookie_parser

from bench.model.clock import NS, Clock
from bench.web.security.tokens import OPERATOR, VIEWER, Tokens

VALID_S = 7 * 86_400  # longer than any run
AHEAD_S = 86_400  # a cookie may come from the future, because clocks are set back, but not from afar
NAME = re.compile(r"\w[\w .'@-]{0,38}[\w.]|\w")  # no comma, no bracket: the name becomes part of "name, role, address"


@dataclass(frozen=True)
class Login:
    """One login of a person: ``id`` differs from login to login, ``role`` is viewer or operator."""

    name: str
    role: str
    id: str

    @property
    def may_command(self) -> bool:
        return self.role == OPERATOR


class Cookies:
    """Writes and reads the cookie of one server: ``name`` is that of the cookie."""

    def __init__(self, tokens: Tokens, clock: Clock, port: int, secure: bool) -> None:
        class _Signer(TimestampSigner):
            """Asks the one clock of the project."""

            def get_timestamp(self) -> int:
                return clock.utc_ns() // NS

        # browsers keep cookies by host alone: the port keeps two benches apart that are reached through ssh -L
        self.name = f"{'__Host-' if secure else ''}bench_login_{port}"
        self._secure = secure
        self._clock = clock
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
        if not -AHEAD_S <= age_s <= VALID_S or role not in (VIEWER, OPERATOR):
            return None
        return Login(name, role, login_id)

    def _attributes(self, value: str, max_age_s: int) -> str:
        secure = "; Secure" if self._secure else ""
        return f"{self.name}={value}; Path=/; Max-Age={max_age_s}; HttpOnly; SameSite=Strict{secure}"


def clean_name(text: str) -> str | None:
    """A person's name as it is shown and recorded: one to 40 letters, digits, blanks and . ' @ -; else None."""
    name = " ".join(unicodedata.normalize("NFC", text).split())
    return name if NAME.fullmatch(name) else None
