"""Whom a run tells what, and how: a command, a mail, a web address. Secrets stay in the environment, by name."""

from __future__ import annotations

from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, StringConstraints, model_validator

from bench.model.units import quantity
from bench.model.yamlio import StrictModel, characters

Words = Annotated[str, characters(500)]
EnvironmentName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,99}$")]
Occasion = Literal["hold", "alarm", "end", "error"]
LOCAL = ("localhost", "127.0.0.1", "::1")


def web_address(text: str) -> str:
    """Return the same text. Raises: ValueError if it is no https address, or holds a password."""
    parts = urlsplit(text)
    if parts.scheme != "https" and not (parts.scheme == "http" and parts.hostname in LOCAL):
        raise ValueError(f"{text!r} is not an https address")
    if parts.username or parts.password:
        raise ValueError("a password does not belong into a file; name an environment variable in 'token_env'")
    return text


class Webhook(StrictModel):
    """A JSON document is posted to an https address."""

    url: Annotated[Words, AfterValidator(web_address)] | None = None
    url_env: EnvironmentName | None = Field(None, description="environment variable that holds the address")
    token_env: EnvironmentName | None = Field(None, description="environment variable that holds a bearer token")

    @model_validator(mode="after")
    def _one_address(self) -> Webhook:
        if (self.url is None) == (self.url_env is None):
            raise ValueError("a webhook has either 'url' or 'url_env'")
        return self


class Mail(StrictModel):
    """A mail is handed to a server."""

    host: Words
    port: int = Field(587, ge=1, le=65535)
    security: Literal["starttls", "tls", "none"] = "starttls"
    sender: Words
    to: list[Words] = Field(min_length=1, max_length=20)
    user: Words | None = None
    password_env: EnvironmentName | None = Field(None, description="environment variable that holds the password")


class Apprise(StrictModel):
    """A program of the extra ``messages`` tells services such as Teams, Slack or ntfy."""

    urls_env: EnvironmentName = Field(
        description="environment variable that holds their addresses, with blanks between"
    )


class Notify(StrictModel):
    """The section ``notify`` of a station."""

    on: list[Occasion] = Field(["hold", "alarm", "end", "error"])
    command: list[Words] | None = Field(None, min_length=1, max_length=20, description="gets a JSON document on stdin")
    email: Mail | None = None
    webhook: Webhook | None = None
    apprise: Apprise | None = None
    heartbeat: Annotated[float, *quantity("s", 10.0, 86_400.0)] | None = Field(
        None, description="a sign of life each, by command and webhook, so that silence is an alarm"
    )

    @model_validator(mode="after")
    def _somebody_is_told(self) -> Notify:
        if self.command is None and self.email is None and self.webhook is None and self.apprise is None:
            raise ValueError("nobody is told: give 'command', 'email', 'webhook' or 'apprise'")
        if self.heartbeat is not None and self.command is None and self.webhook is None:
            raise ValueError("'heartbeat' goes out by 'command' or 'webhook'; give one of them")
        return self
