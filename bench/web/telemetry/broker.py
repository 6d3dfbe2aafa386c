"""Tells a broker of MQTT what every run does, from the page server: no run knows of it or waits for it.

    PREFIX/status            "online" or, by the broker itself when the server is gone, "offline"
    PREFIX/runs/RUN/state    the state document without what is long

All of them are retained and sent with quality 0, each second at most. Nothing is queued for a broker that is away:
when it is back it is told how things are now. Source: MQTT 3.1.1 (OASIS); the client is paho-mqtt.
"""

from __future__ import annotations

import json
import logging
import re
import socket
import ssl
import threading
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote, urlsplit

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags, MQTTMessage, topic_matches_sub
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from bench.model.clock import pause
from bench.model.errors import InputError
from bench.web.telemetry.lookout import Lookout, SeenRun

EACH_S = 1.0
FIRST_ANSWER_S = 5.0
KEEP_ALIVE_S = 30
RETRY_S = (1, 60)  # the first and the longest pause before the next attempt
MOST_LEFT = 10_000  # topics of earlier runs that are taken away
PASSWORD = "BENCH_MQTT_PASSWORD"
PORTS = {"mqtt": 1883, "mqtts": 8883}
RUNS = "runs/+/state"
LONG = ("log", "signals", "graphs", "timetable", "instruments")
_PREFIX = re.compile(r"[^\s+#$\x00-\x1f/][^+#\x00-\x1f]{0,199}")
_REFUSED = ("Bad user name or password", "Not authorized")
_EXAMPLE = "for example mqtts://bench@broker.example.org/lab/bench-1, the password in the variable " + PASSWORD

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Address:
    """Where a broker listens, who logs in, and what every topic begins with."""

    host: str
    port: int
    prefix: str
    tls: bool = False
    user: str | None = None

    def __str__(self) -> str:
        return f"{self.host} port {self.port}"


def address_of(url: str) -> Address:
    """Return what ``mqtt://USER@HOST:PORT/PREFIX`` says; the prefix is ``bench/`` and the name of this machine if none.

    Raises: InputError B-WEB-025, without the URL, which may hold a password.
    """
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    prefix = unquote(parts.path).strip("/") or f"bench/{socket.gethostname()}"
    if parts.scheme not in PORTS or not parts.hostname or parts.query or parts.fragment:
        wrong = "this is not the address of a broker"
    elif parts.password is not None:
        wrong = "a password stands in the address, which everybody on this machine may read"
    elif _PREFIX.fullmatch(prefix) is None:
        wrong = "no topic begins like that"
    else:
        user = None if parts.username is None else unquote(parts.username)
        return Address(parts.hostname, port or PORTS[parts.scheme], prefix, parts.scheme == "mqtts", user)
    raise InputError("B-WEB-025", wrong, where="--mqtt", next_step=_EXAMPLE)


class Broker:
    """The connection to a broker; a thread of paho keeps it and brings it back."""

    def __init__(self, address: Address, password: str | None) -> None:
        self._address = address
        self._told: dict[str, str] = {}  # what the broker holds of us, by topic
        self._left: set[str] = set()  # topics that it held when we came
        self._answered = threading.Event()
        self._refusal = ""
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.reconnect_delay_set(*RETRY_S)
        self._client.will_set(self._topic("status"), "offline", retain=True)
        if address.user is not None:
            self._client.username_pw_set(address.user, password)
        if address.tls:
            self._client.tls_set_context(ssl.create_default_context())
        self._client.on_connect = self._on_connect
        self._client.on_disconnect = self._on_disconnect
        self._client.on_message = self._on_message

    def start(self) -> str:
        """Connect and return how that went in a line; one that is not reached is tried again, for ever.

        Raises: InputError B-WEB-026 if the broker refuses who logs in, or its certificate is not trusted.
        """
        where = f"broker {self._address}"
        try:
            self._client.connect(self._address.host, self._address.port, KEEP_ALIVE_S)
        except ssl.SSLError as error:
            raise self._refused(f"no TLS with it: {getattr(error, 'verify_message', '') or error.reason}") from error
        except OSError as error:
            self._client.connect_async(self._address.host, self._address.port, KEEP_ALIVE_S)
            self._client.loop_start()
            return f"{where} is not reached yet ({error.strerror or error}); it is tried again"
        self._client.loop_start()
        answered = self._answered.wait(FIRST_ANSWER_S)
        if self._refusal in _REFUSED:
            self.stop()
            raise self._refused(f"it refuses the login: {self._refusal}")
        if not answered or self._refusal:
            return f"{where} does not take messages yet ({self._refusal or 'no answer'}); it is tried again"
        return f"{where} is told of every run below {self._address.prefix}"

    async def tell(self, lookout: Lookout) -> None:
        """Publish what has changed, each second, until it is cancelled."""
        while True:
            try:
                self._publish(await lookout.runs())
            except Exception:  # whatever goes wrong with it, the page goes on
                log.exception("the broker is not told")
            await pause(EACH_S)

    def stop(self) -> None:
        """Say goodbye; waits a second at most for a broker that does not listen."""
        if self._client.is_connected():
            self._client.publish(self._topic("status"), "offline", retain=True).wait_for_publish(1.0)
        self._client.disconnect()
        self._client.loop_stop()

    def _publish(self, runs: tuple[SeenRun, ...]) -> None:
        if not self._client.is_connected() or self._client.want_write():  # it does not take what it was sent already
            return
        due = {self._topic(f"runs/{run.state['run']}/state"): document_of(run) for run in runs}
        for topic in (self._left | set(self._told)) - set(due):  # nobody must take them for runs of now
            self._client.publish(topic, b"", retain=True)
            self._told.pop(topic, None)
        self._left = set()
        for topic, text in due.items():
            if self._told.get(topic) != text:
                self._client.publish(topic, text, retain=True)
                self._told[topic] = text

    def _topic(self, name: str) -> str:
        return f"{self._address.prefix}/{name}"

    def _refused(self, why: str) -> InputError:
        advice = f"check the user in --mqtt, {PASSWORD}, and the certificate ($SSL_CERT_FILE names one of your own)"
        return InputError("B-WEB-026", f"the broker cannot be used: {why}", where=str(self._address), next_step=advice)

    # --- on the thread of paho -----------------------------------------------------------------------------------

    def _on_connect(
        self, client: Client, userdata: object, flags: ConnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        del userdata, flags, properties
        refusal = reason.getName() if reason.is_failure else ""
        if refusal and self._answered.is_set() and refusal != self._refusal:
            log.error("the broker %s refuses: %s", self._address, refusal)
        self._refusal = refusal
        self._answered.set()
        if not refusal:
            self._told = {}  # one that was started afresh holds nothing
            client.subscribe(self._topic(RUNS))
            client.publish(self._topic("status"), "online", retain=True)

    def _on_disconnect(
        self, client: Client, userdata: object, flags: DisconnectFlags, reason: ReasonCode, properties: object
    ) -> None:
        del client, userdata, flags, properties
        if reason.is_failure and not self._refusal:
            log.warning("the broker %s is gone; it is tried again", self._address)

    def _on_message(self, client: Client, userdata: object, message: MQTTMessage) -> None:
        del client, userdata
        is_held = bool(message.retain and message.payload)  # else it is our own, of now
        if is_held and topic_matches_sub(self._topic(RUNS), message.topic) and len(self._left) < MOST_LEFT:
            self._left = self._left | {message.topic}


def document_of(run: SeenRun) -> str:
    """Return the message about a run: its state document without ``LONG`` and without the past of its estimates."""
    state: dict[str, Any] = {key: value for key, value in run.state.items() if key not in LONG}
    estimates = state.get("estimates")
    if isinstance(estimates, dict):
        rows = [{key: value for key, value in row.items() if key != "history"} for row in estimates.get("rows") or ()]
        state["estimates"] = {**estimates, "rows": rows}
    state |= {"temperatures_degC": run.temperatures_degC, "age_s": run.age_s}
    return json.dumps(state, separators=(",", ":"), allow_nan=False)
