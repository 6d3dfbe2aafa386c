"""The ways a message leaves the bench: a command, a mail, a web address, Apprise. Each ends within its time-out.

Secrets are read from the environment when a message is sent; they are in no file and in no session.
"""

from __future__ import annotations

import importlib.util
import json
import os
import smtplib
import ssl
import subprocess
import urllib.request
from collections.abc import Callable, Mapping
from email.message import EmailMessage
from functools import partial
from typing import Any

from bench.model.posix import APPRISE
from bench.plan import Apprise, Mail, Notify, Webhook, web_address

TIMEOUT_S = 10.0
ATTEMPTS = 3
_APPRISE_TYPES = {"hold": "warning", "alarm": "warning", "error": "failure"}
Message = dict[str, Any]


class NotSent(Exception):
    """A message did not get through; the text says why, without secrets."""


def ways_of(notify: Notify) -> list[tuple[str, Callable[[Message], None]]]:
    """Return the ways that a section ``notify`` names, with their names; each raises NotSent."""
    sections = ((name, send, getattr(notify, name)) for name, send in _WAYS.items())
    return [(name, partial(send, section)) for name, send, section in sections if section is not None]


def by_command(words: list[str], message: Message) -> None:
    """Start a program with the message as JSON on its standard input. Raises: NotSent."""
    _give(words[0], words, json.dumps(message))


def _give(name: str, words: list[str], text: str, environment: Mapping[str, str] | None = None) -> None:
    """Start a program with a text on its standard input and wait for its end. Raises: NotSent, with its ``name``."""
    try:
        done = subprocess.run(
            words, input=text.encode(), env=environment, timeout=TIMEOUT_S, check=False, start_new_session=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise NotSent(f"{name}: {type(error).__name__}") from error
    if done.returncode:
        raise NotSent(f"{name}: exit status {done.returncode}")


def by_webhook(webhook: Webhook, message: Message) -> None:
    """Post the message as JSON; redirects are not followed, so that it goes where the file says. Raises: NotSent."""
    url = webhook.url or _secret(webhook.url_env)
    headers = {"Content-Type": "application/json", "User-Agent": "inertial-bench"}
    if webhook.token_env:
        headers["Authorization"] = f"Bearer {_secret(webhook.token_env)}"
    try:
        web_address(url)
        request = urllib.request.Request(url, json.dumps(message).encode(), headers, method="POST")
        with urllib.request.build_opener(_NoRedirect).open(request, timeout=TIMEOUT_S) as reply:
            reply.read(1000)
    except (OSError, ValueError) as error:
        code = getattr(error, "code", None)
        raise NotSent(f"webhook: {type(error).__name__}{'' if code is None else f' {code}'}") from None


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        return None


def by_mail(mail: Mail, message: Message) -> None:
    """Hand a mail to the server. Raises: NotSent."""
    letter = EmailMessage()
    letter["Subject"] = _title(message)
    letter["From"], letter["To"] = mail.sender, ", ".join(mail.to)
    letter.set_content(_lines(message))
    trusted = ssl.create_default_context()
    try:
        with (
            smtplib.SMTP_SSL(mail.host, mail.port, timeout=TIMEOUT_S, context=trusted)
            if mail.security == "tls"
            else smtplib.SMTP(mail.host, mail.port, timeout=TIMEOUT_S)
        ) as server:
            if mail.security == "starttls":
                server.starttls(context=trusted)
            if mail.user:
                server.login(mail.user, _secret(mail.password_env))
            server.send_message(letter)
    except (OSError, smtplib.SMTPException) as error:
        raise NotSent(f"mail: {type(error).__name__}") from error


def by_apprise(apprise: Apprise, message: Message) -> None:
    """Hand the message to Apprise in a process of its own, its addresses by environment. Raises: NotSent."""
    if importlib.util.find_spec("apprise") is None:
        raise NotSent("apprise is not installed: pip install 'inertial-bench[messages]'")
    words = [*APPRISE, "--storage-mode", "memory", "--title", _title(message)]
    words += ["--notification-type", _APPRISE_TYPES.get(str(message["kind"]), "info")]
    secret = {**os.environ, "APPRISE_URLS": _secret(apprise.urls_env)}
    _give("apprise", words, _lines(message), secret)


_WAYS: dict[str, Callable[[Any, Message], None]] = {  # by section of ``notify``, in the order of sending
    "command": by_command, "webhook": by_webhook, "email": by_mail, "apprise": by_apprise,
}  # fmt: skip


def _title(message: Message) -> str:
    return f"[bench] {message['kind']}: {message['session']}"


def _lines(message: Message) -> str:
    return "\n".join(f"{name}: {value}" for name, value in message.items())


def _secret(name: str | None) -> str:
    if name is None or name not in os.environ:
        raise NotSent(f"the environment variable {name} is not set")
    return os.environ[name]
