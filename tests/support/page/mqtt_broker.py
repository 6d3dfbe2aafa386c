"""A broker of MQTT on loopback as a process of its own, with one user; and what it is told.

The broker is amqtt, in the environment that ``make test`` makes for it beside that of the tests, or in this one.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

USER, SECRET = "bench", "a secret"
PATIENCE_S = 30.0
PROGRAM = Path(__file__).with_name("amqtt_program.py")


class MqttBroker:
    """Listens on ``port`` until it is killed; it can be started again and holds nothing then."""

    def __init__(self, folder: Path, port: int) -> None:
        self.port = port
        self._users = folder / "users"
        self.process: subprocess.Popen[str]
        self.start()

    def start(self) -> None:
        words = [_python(), str(PROGRAM), str(self.port), str(self._users), USER, SECRET]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "listening\n"

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


def _python() -> str:
    """Return the interpreter that has the broker; skips the test where there is none."""
    own = Path(sys.prefix) / "broker" / "bin" / "python"
    if not own.exists() and importlib.util.find_spec("amqtt") is None:
        pytest.skip("no broker of MQTT on this machine: 'make test' installs amqtt")
    return str(own) if own.exists() else sys.executable


class Subscriber:
    """Hears everything below a prefix; ``told`` is the last message of each topic, "" where it was taken away."""

    def __init__(self, port: int, prefix: str) -> None:
        self.told: dict[str, str] = {}
        self._news = threading.Condition()
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.username_pw_set(USER, SECRET)
        self._client.reconnect_delay_set(1, 1)
        self._client.on_message = lambda client, userdata, message: self._hear(message.topic, message.payload.decode())
        self._client.on_connect = lambda client, *_: client.subscribe(f"{prefix}/#", 1)
        self._client.connect("127.0.0.1", port)
        self._client.loop_start()

    def _hear(self, topic: str, text: str) -> None:
        with self._news:
            self.told[topic] = text
            self._news.notify_all()

    def until(self, topic: str, is_right: Callable[[str], bool] = bool) -> str:
        """Return the message of a topic as soon as it is right."""
        with self._news:
            came = self._news.wait_for(lambda: topic in self.told and is_right(self.told[topic]), PATIENCE_S)
            assert came, self.told
            return self.told[topic]

    def __enter__(self) -> Subscriber:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.disconnect()
        self._client.loop_stop()
