"""``bench coefficients``: sessions are fitted again, merged and written; what does not belong together is refused."""

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any

import fit_simulation as sim
import pytest

from bench import cli
from bench.commands import session as command
from bench.model.errors import InputError
from bench.session.view import SessionView


def view(campaign: sim.SimulatedCampaign, name: str, **section: Any) -> SessionView:
    manifest = {
        "session": name,
        "campaign": campaign.campaign | section,
        "standards": campaign.standards,
        "simulated": True,
        "plan_sha256": "p",
        "measurement_link": "port_a",
    }
    return SessionView(manifest=manifest, rows=campaign.rows, counts={}, session_sha256=f"sha of {name}")


@pytest.fixture
def sessions(monkeypatch: pytest.MonkeyPatch) -> dict[str, SessionView]:
    """Sessions by the name of their folder, without the folders."""
    whole = sim.simulate(8)
    first, second = (
        dataclasses.replace(whole, rows=[row for row in whole.rows if row.window.conditions["channel"] == channel])
        for channel in (1, 2)
    )
    flat = sim.simulate(8, temperatures=(20.0,))
    views = {
        "first": view(first, "first"),
        "second": view(second, "second"),
        "flat": view(flat, "flat"),
        "recorded": view(whole, "recorded", analysis="none"),
    }
    monkeypatch.setattr(command, "read_view", lambda folder, strict: views[folder.name])
    return views


def test_two_sessions_become_one_pair_of_files(
    sessions: dict[str, SessionView],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Each session holds one of the two declared channels; what each lacks is said, and is in the other."""
    monkeypatch.setattr(sys, "argv", ["bench", "coefficients", "first", "second", "--out", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as caught:
        cli.main()
    assert caught.value.code == 0
    document = json.loads((tmp_path / "out" / "coefficients.json").read_text())
    assert [(one["parameter"], one["channel"], one["session"]) for one in document["parameters"]] == [
        ("dsf_n", 1, "first"),
        ("dsf_n", 2, "second"),
        ("dsf_p", 1, "first"),
        ("dsf_p", 2, "second"),
    ]
    assert [one["session_sha256"] for one in document["sources"]] == ["sha of first", "sha of second"]
    assert "sha of second" in (tmp_path / "out" / "coefficients.h").read_text()
    said = capsys.readouterr().out
    assert "coefficients.h" in said
    assert "MISSING  channel 2: no record" in said


@pytest.mark.parametrize("name", ["flat", "recorded"])
def test_a_session_without_coefficients_is_refused(sessions: dict[str, SessionView], tmp_path: Path, name: str) -> None:
    """One temperature only, or no analysis at all; nothing is written."""
    with pytest.raises(InputError, match="gives no coefficients") as caught:
        command.coefficients([Path("first"), Path(name)], tmp_path / "out")
    assert (caught.value.code, caught.value.where) == ("B-COEF-005", name)
    assert not (tmp_path / "out").exists()


def test_the_same_session_twice_is_refused(sessions: dict[str, SessionView], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="B-COEF-002: "):
        command.coefficients([Path("first"), Path("first")], tmp_path)
