"""A broker of another project receives what the page server tells; one that dies or refuses harms nobody."""

import asyncio
import gc
import importlib.util
import json
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import SimpleNamespace, TracebackType
from typing import Any

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion
from shown_run import ShownRun
from web_rig import Page, served, started

from bench.model.errors import InputError
from bench.web.telemetry import SeenRun
from bench.web.telemetry.broker import LONG, PASSWORD, Address, Broker, address_of, document_of

USER, SECRET = "bench", "a secret"
PATIENCE_S = 30.0
PROGRAM = Path(__file__).resolve().parents[3] / "support" / "page" / "amqtt_program.py"
RUN = "20260101T000000Z_shown_7"
STATE = f"lab/one/runs/{RUN}/state"
END_S = 30.0


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

    def __enter__(self) -> "Subscriber":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.disconnect()
        self._client.loop_stop()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[MqttBroker]:
    found = MqttBroker(tmp_path, free_port())
    yield found
    found.kill()


def told_to(port: int) -> tuple[str, str]:
    return "--mqtt", f"mqtt://{USER}@127.0.0.1:{port}/lab/one"


@contextmanager
def telling(top: Path, port: int) -> Iterator[Page]:
    """A page server in this process that tells a broker, and fits nothing."""
    broker = Broker(Address("127.0.0.1", port, "lab/one", user=USER), SECRET)
    assert broker.start() == f"broker 127.0.0.1 port {port} is told of every run below lab/one"
    try:
        with served(top, tell=broker.tell) as page:
            page.app.state.hub.fit = lambda folder: asyncio.sleep(0)
            yield page
    finally:
        broker.stop()


def is_running(text: str) -> bool:
    """Return whether a message is one of a run that answers; the first look may come before its socket is there."""
    return bool(json.loads(text)["state"] == "running")


def test_a_broker_is_told_of_a_run_and_of_the_end_of_the_server(tmp_path: Path, broker: MqttBroker) -> None:
    with Subscriber(broker.port, "lab/one") as heard:
        with telling(tmp_path, broker.port) as page:
            shown = ShownRun(page.serving.out, RUN)
            assert heard.until("lab/one/status") == "online"
            state = json.loads(heard.until(STATE, is_running))
            assert set(state) == set(shown.state) - set(LONG) | {"estimates", "operator", "temperatures_degC", "age_s"}
            assert state["links"] == shown.state["links"]
            assert (state["state"], state["progress"], state["records"]["done"]) == ("running", 0.38, 3)
            assert state["temperatures_degC"]["bench.air"] == pytest.approx(54.8, abs=0.03)
            with Subscriber(broker.port, "lab/one") as late:  # retained: whoever comes later knows at once
                assert json.loads(late.until(STATE))["run"] == RUN
            shown.close()
            lost = json.loads(heard.until(STATE, lambda text: not is_running(text)))
            assert (lost["state"], lost["bench"]["state"], lost["temperatures_degC"]) == ("stopped", "unknown", {})
            assert "links" not in lost
        assert heard.until("lab/one/status", lambda text: text != "online") == "offline"


def test_the_broker_itself_says_that_a_server_was_killed_and_one_that_comes_clears_what_is_left(
    tmp_path: Path, broker: MqttBroker
) -> None:
    (tmp_path / "sessions").mkdir()
    shown = ShownRun(tmp_path / "sessions", RUN)
    with Subscriber(broker.port, "lab/one") as heard:
        with started(tmp_path, *told_to(broker.port), **{PASSWORD: SECRET}) as (process, said):
            assert f"broker 127.0.0.1 port {broker.port} is told of every run below lab/one" in said
            assert SECRET not in said
            heard.until(STATE)
            process.kill()
            assert heard.until("lab/one/status", lambda text: text != "online") == "offline"
        assert heard.told[STATE].startswith("{")
        shown.close()
        (shown.folder / "session.open").unlink()
        with started(tmp_path, *told_to(broker.port), **{PASSWORD: SECRET}):
            assert heard.until("lab/one/status", lambda text: text != "offline") == "online"
            assert heard.until(STATE, lambda text: not text) == ""


def test_a_broker_that_dies_is_told_again_when_it_is_back(tmp_path: Path, broker: MqttBroker) -> None:
    with telling(tmp_path, broker.port) as page:
        shown = ShownRun(page.serving.out, RUN)
        with Subscriber(broker.port, "lab/one") as heard:
            heard.until(STATE, is_running)
        broker.kill()
        shown.state["progress"] = 0.5
        assert page.ask("GET", "/").status == 401  # the page goes on
        broker.start()
        with Subscriber(broker.port, "lab/one") as again:
            assert again.until("lab/one/status") == "online"
            assert json.loads(again.until(STATE, is_running))["progress"] == 0.5
        shown.close()


def test_a_wrong_password_is_one_line_before_anything_is_served(tmp_path: Path, broker: MqttBroker) -> None:
    with started(tmp_path, *told_to(broker.port), **{PASSWORD: "not it"}) as (process, said):
        assert process.wait(END_S) == 2
    assert said.count("\n") == 1
    assert said.startswith("error B-WEB-026: ")
    assert "not it" not in said
    assert PASSWORD in said


def test_a_broker_that_is_not_there_is_tried_again(tmp_path: Path) -> None:
    port = free_port()
    broker = Broker(Address("127.0.0.1", port, "lab/one", user=USER), SECRET)
    with ExitStack() as stack:
        stack.callback(broker.stop)  # also where no broker is installed
        assert broker.start().startswith(f"broker 127.0.0.1 port {port} is not reached yet (")
        late = MqttBroker(tmp_path, port)
        stack.callback(late.kill)
        with Subscriber(port, "lab/one") as heard:
            assert heard.until("lab/one/status") == "online"
            broker.stop()
            assert heard.until("lab/one/status", lambda text: text != "online") == "offline"


# paho leaves the socket of a handshake that failed to the garbage collector
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning")
def test_one_that_is_no_broker_of_tls_is_refused() -> None:
    """A server that answers in clear to a client that begins with TLS."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def answer() -> None:
            connection, _ = listener.accept()
            with connection:
                connection.recv(65_536)
                connection.sendall(b"no TLS is spoken here\r\n")

        thread = threading.Thread(target=answer)
        thread.start()
        port = listener.getsockname()[1]
        with pytest.raises(InputError) as refused:
            Broker(Address("127.0.0.1", port, "bench", tls=True), None).start()
        thread.join()
    code = refused.value.code
    del refused
    gc.collect()
    assert code == "B-WEB-026"


def test_what_a_broker_does_not_take_is_not_queued() -> None:
    sent: list[str] = []
    away = {"is_connected": lambda: True, "want_write": lambda: True}
    client = SimpleNamespace(**away, publish=lambda topic, text, retain: sent.append(topic))
    broker = Broker(address_of("mqtt://here/p"), None)
    broker._client = client  # type: ignore[assignment]
    run = SeenRun({"run": RUN, "state": "running"})

    class Looked:
        async def runs(self) -> tuple[SeenRun, ...]:
            return (run,)

    async def tell(seconds: float) -> None:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(broker.tell(Looked()), seconds)  # type: ignore[arg-type]

    asyncio.run(tell(0.2))
    assert sent == []
    client.want_write = lambda: False
    asyncio.run(tell(0.2))
    asyncio.run(tell(0.2))  # nothing is new
    assert sent == [f"p/runs/{RUN}/state"]


def test_a_message_leaves_out_what_is_long_and_is_json() -> None:
    rows: list[dict[str, Any]] = [{"quantity": "bias", "value": 1.0, "history": [[1, 1.0, 0.1]]}]
    state = {
        "run": RUN,
        "title": 'a"\n\udc80',
        "log": [1],
        "instruments": {},
        "estimates": {"rows": rows, "records": 3},
    }
    text = document_of(SeenRun(state, {"bench.air": 20.0}, 0.5))
    text.encode("ascii")
    assert json.loads(text) == {
        "run": RUN, "title": 'a"\n\udc80', "estimates": {"rows": [{"quantity": "bias", "value": 1.0}], "records": 3},
        "temperatures_degC": {"bench.air": 20.0}, "age_s": 0.5,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("url", "due"),
    [
        ("mqtt://b.example.org", Address("b.example.org", 1883, f"bench/{socket.gethostname()}")),
        ("mqtts://kim@b.example.org/lab/1/", Address("b.example.org", 8883, "lab/1", True, "kim")),
        ("mqtt://k%40im@[::1]:99/a%20b", Address("::1", 99, "a b", False, "k@im")),
    ],
)
def test_an_address(url: str, due: Address) -> None:
    assert address_of(url) == due


@pytest.mark.parametrize(
    "url",
    ["", "broker", "http://b/", "mqtt://", "mqtt://b:port/", "mqtt://b:99999", "mqtt://[::1", "mqtt://b/a#b",
     "mqtt://b/a%23", "mqtt://b/+/x", "mqtt://b/$SYS", "mqtt://b/x?y=1", "mqtt://kim:hidden@b/x"],
)  # fmt: skip
def test_what_is_no_address(url: str) -> None:
    with pytest.raises(InputError) as refused:
        address_of(url)
    assert refused.value.code == "B-WEB-025"
    assert "hidden" not in str(refused.value)
