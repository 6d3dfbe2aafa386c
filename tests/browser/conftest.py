"""The browser, the page server and a shown run for all browser tests; skipped where there is no Chromium."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser_rig import PATIENCE_MS, PageServer, chromium
from playwright.sync_api import Browser, expect
from shown_run import ShownRun, stage_living, stage_over

expect.set_options(timeout=PATIENCE_MS)


@pytest.fixture(scope="module")  # Playwright keeps an event loop running, which tests of other folders start themselves
def browser() -> Iterator[Browser]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageServer]:
    started = PageServer(tmp_path_factory.mktemp("page"))
    yield started
    started.end()


@pytest.fixture
def shown(server: PageServer, request: pytest.FixtureRequest) -> Iterator[ShownRun]:
    run = ShownRun(server.out, f"20260101T000000Z_{request.node.name.replace('[', '_').replace(']', '')[:60]}_7")
    yield run
    run.close()


@pytest.fixture(scope="session")
def living(server: PageServer) -> Iterator[dict[str, ShownRun]]:
    """Runs in the situations of tests/support/page/shown_run.py, by the name of the situation."""
    runs = stage_living(server.out)
    yield runs
    for run in runs.values():
        run.close()


@pytest.fixture(scope="session")
def over(server: PageServer, golden: Path) -> dict[str, str]:
    """Names of sessions that are over, by how they ended."""
    return stage_over(server.out, golden)


@pytest.fixture(scope="session")
def screenshots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where pictures go for a person to look at: $BENCH_SCREENSHOTS, or that of the run, kept if a test fails."""
    wanted = os.environ.get("BENCH_SCREENSHOTS")
    folder = Path(wanted) if wanted else tmp_path_factory.mktemp("screenshots")
    folder.mkdir(parents=True, exist_ok=True)
    return folder
