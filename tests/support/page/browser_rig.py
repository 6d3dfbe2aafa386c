"""A page server as a process of its own, and pages of a real browser that complain of what must never happen."""

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, BrowserContext, CDPSession, Error, Page, sync_playwright

WATCH = """
window.violations = [];
document.addEventListener("securitypolicyviolation", (event) => {
  window.violations.push(`${event.violatedDirective} ${event.blockedURI}`);
});
"""
PATIENCE_MS = 20_000


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser; skips the test where there is none."""
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no Chromium on this machine: install the package 'chromium' to run the browser tests")
    words = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=path, args=words)
        yield found
        found.close()


class PageServer:
    """``bench serve`` on one port, which it keeps when it is started again; ``shown`` in place of ``--out``."""

    def __init__(self, top: Path, program: Sequence[str] = ("-m", "bench"), shown: Sequence[str] = ()) -> None:
        self._program, self._shown = program, shown
        self.out, self._private = top / "sessions", top / "private"
        self.out.mkdir()
        self._private.mkdir()
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self.tokens: dict[str, str] = {}
        self.start()

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def start(self) -> None:
        shown = self._shown or ("--out", str(self.out))
        command = [sys.executable, *self._program, "serve", *shown, "--port", str(self.port)]
        environment = {**os.environ, "XDG_CONFIG_HOME": str(self._private)}
        self.process = subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert self.process.stdout is not None
        for line in self.process.stdout:
            for role in ("viewer", "operator", "bench"):
                if line.startswith(f"{role} token:"):
                    self.tokens[role] = line.partition(": ")[2].strip()
            if line.startswith("Ctrl-C"):
                return
        raise AssertionError("bench serve did not start")

    def end(self, number: int = signal.SIGTERM) -> None:
        self.process.send_signal(number)
        self.process.wait(20)
        self.process.stdout.close()


class Visitor:
    """One browser window, logged in; everything wrong that it meets is kept in ``wrong``."""

    def __init__(self, server: PageServer, context: BrowserContext) -> None:
        self.server, self.context = server, context
        self.wrong: list[str] = []
        self.page = context.new_page()
        self.page.set_default_timeout(PATIENCE_MS)
        self.page.add_init_script(WATCH)
        self.page.on("pageerror", lambda error: self.wrong.append(f"script: {error}"))
        self.page.on("console", self._hear)
        self.page.on("request", self._look_at)
        self.requests: list[Any] = []

    def _hear(self, said: Any) -> None:
        if said.type in ("error", "warning"):
            self.wrong.append(f"console: {said.text}")

    def _look_at(self, request: Any) -> None:
        self.requests.append(request)
        if not request.url.startswith((self.server.origin, "data:", "blob:")):
            self.wrong.append(f"request to {request.url}")

    def login(self, role: str, name: str = "kim") -> None:
        form = {"name": name, "token": self.server.tokens[role], "back_to": "/"}
        answer = self.context.request.post(
            f"{self.server.origin}/login", form=form, headers={"Origin": self.server.origin}
        )
        assert answer.ok, answer.text()

    def open_run(self, name: str) -> Page:
        self.page.goto(f"{self.server.origin}/runs/{name}")
        self.page.wait_for_selector("body[data-fresh=fresh]")
        self.page.wait_for_selector("#graphs figure .ends button")
        return self.page

    def violations(self) -> list[str]:
        return list(self.page.evaluate("window.violations"))


def metrics(cdp: CDPSession) -> dict[str, float]:
    """What the page holds after everything that can go has gone: JSHeapUsedSize, Nodes, JSEventListeners and so on."""
    cdp.send("HeapProfiler.collectGarbage")
    return {one["name"]: one["value"] for one in cdp.send("Performance.getMetrics")["metrics"]}


def until(page: Page, true: Callable[[], bool], what: str) -> None:
    """Wait for something the page will do; the page goes on meanwhile."""
    for _ in range(PATIENCE_MS // 100):
        if true():
            return
        page.wait_for_timeout(100)
    raise AssertionError(f"never came: {what}")


@contextmanager
def visiting(
    browser: Browser, server: PageServer, role: str | None, *, may_fail: bool = False, **options: Any
) -> Iterator[Visitor]:
    """A visitor of a role (None: not logged in). Fails on any violation of the content policy, on anything the console
    complains of, and on a request to another host."""
    context = browser.new_context(**{"viewport": {"width": 1600, "height": 1000}, "color_scheme": "dark", **options})
    try:
        visitor = Visitor(server, context)
        if role is not None:
            visitor.login(role)
        yield visitor
        assert visitor.violations() == []
        if not may_fail:
            assert visitor.wrong == []
    finally:
        with suppress(Error):  # the browser is gone already; what was wrong is told by then
            context.close()
