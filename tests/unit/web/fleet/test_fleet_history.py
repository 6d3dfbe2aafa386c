"""What stands below the benches is what ``bench history`` prints."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import store_sample
from web_rig import Page, served

from bench.commands.history import show
from bench.commands.requests import Place, ServeRequest
from bench.commands.serve import serve
from bench.model.errors import BenchError
from bench.store import Filters, record_calibration
from bench.web.fleet.app import create_fleet_app
from bench.web.fleet.calibrated import LONGEST_DAYS
from bench.web.security.tokens import VIEWER


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> str:
    url = f"sqlite:///{tmp_path_factory.mktemp('history') / 'history.sqlite'}"
    for number, (document, manifest) in enumerate(store_sample.calibrations(4, 200.0, 17)):
        other = {**document, "uut": {"model": "NGU", "serial": "B2"}} if number == 3 else document
        record_calibration(url, other, manifest, None)
    return url


@pytest.fixture(scope="module")
def page(url: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    top = tmp_path_factory.mktemp("fleet")
    with served(top, make=lambda serving: create_fleet_app(serving, ()), history=url) as server:
        yield server


def test_who_is_due_is_what_the_command_says(page: Page, url: str, capsys: pytest.CaptureFixture[str]) -> None:
    answer = page.ask("GET", "/api/v1/due", page.cookie(VIEWER)).json
    assert show.due(Place(url, None), Filters(), LONGEST_DAYS, True) == 1
    said = json.loads(capsys.readouterr().out)["due"]
    assert len(said) == 2
    assert answer["due"] == sorted(said, key=lambda due: due["due_utc"])
    assert answer["named"] is True


def test_sessions_over_all_are_the_history_newest_first(
    page: Page, url: str, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = page.ask("GET", "/api/v1/calibrations", page.cookie(VIEWER)).json
    show.list_all(Place(url, None), Filters(), True)
    assert answer["calibrations"] == json.loads(capsys.readouterr().out)["calibrations"][::-1]
    assert [row["uut_serial"] for row in answer["calibrations"]] == ["B2", "A1", "A1", "A1"]


@pytest.mark.parametrize(("file", "status"), [("nothing.sqlite", 200), ("text.sqlite", 400)])
def test_a_history_that_is_not_there_is_empty_and_one_that_cannot_be_read_says_why(
    tmp_path: Path, file: str, status: int
) -> None:
    (tmp_path / "text.sqlite").write_text("no database " * 100)
    url = f"sqlite:///{tmp_path / file}"
    with served(tmp_path, make=lambda serving: create_fleet_app(serving, ()), history=url) as page:
        answer = page.ask("GET", "/api/v1/due", page.cookie(VIEWER))
        assert answer.status == status
        assert answer.json.get("due", []) == []
        assert answer.json.get("error", "").startswith("B-STORE") is (status == 400)


def test_an_address_that_can_never_be_opened_is_refused_before_anything_is_served(tmp_path: Path) -> None:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(f"benches:\n  - {{name: here, folder: '{tmp_path}'}}\n")
    with pytest.raises(BenchError) as raised:
        serve(ServeRequest(fleet=fleet, history="nonsense"))
    assert raised.value.code == "B-STORE-001"
