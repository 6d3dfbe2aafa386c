"""Pause, look, let go on and abort a run from another process, as a person at another terminal does."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from rehearsal import ROOT, Inside
from waiting import until

from bench.commands.control import ask
from bench.model.errors import BenchError
from bench.record import SessionReader

pytestmark = pytest.mark.waits

WAIT_S = 120.0


def status(folder: Path) -> dict[str, Any]:
    try:
        return ask(folder, "status")
    except BenchError:
        return {}


def arranged(folder: Path) -> tuple[Path, Path]:
    """The half-minute campaign with an early verdict, a user who wants to be told, and where he is told."""
    text = (ROOT / "sequences" / "scale_factor_wall_30s.yaml").read_text()
    head, _, rest = text.partition("\nuut:")
    sequence = folder / "sequences" / "scale_factor_wall_30s.yaml"
    sequence.parent.mkdir()
    sequence.write_text(f"{head}\nearly: {{after: 2 s, every: 1 h, max_lost: 50 %, max_bad: 50 %}}\nuut:{rest}")
    caught = folder / "caught"
    config = folder / "config" / "inertial-bench"
    config.mkdir(parents=True)
    program = f"import sys; open({str(caught)!r}, 'a').write(sys.stdin.read() + chr(10))"
    (config / "notify.yaml").write_text(f"command: {json.dumps([sys.executable, '-c', program])}\n")
    return sequence, caught


@pytest.mark.slow
def test_another_terminal_pauses_resumes_and_aborts_a_run(tmp_path: Path, inside: Inside) -> None:
    out = tmp_path / "out"
    sequence, caught = arranged(tmp_path)
    command = [sys.executable, "-m", "bench", "run", str(sequence), "--clock", "wall", "--out", str(out)]
    environment = {**os.environ, "XDG_CONFIG_HOME": str(tmp_path / "config")}
    log = (tmp_path / "log").open("w+")
    with log, subprocess.Popen(command, stdout=log, stderr=log, env=environment) as run:
        try:
            folder = until(lambda: next(iter(out.glob("*_SIM-1*")), None), "a session", WAIT_S)
            until(lambda: status(folder).get("records", 0) >= 1, "a record", WAIT_S)
            assert inside("pause", str(folder), "--reason", "door open").returncode == 0
            held = until(lambda: (now := status(folder)).get("state") == "holding" and now, "a hold", WAIT_S)
            assert any("door open" in reason for reason in held["reasons"].values())
            until(lambda: caught.exists() and '"hold"' in caught.read_text(), "the news of it", WAIT_S)
            verdict = until(lambda: "early verdict" in (tmp_path / "log").read_text(), "a verdict", WAIT_S)
            assert verdict
            assert inside("resume", str(folder)).returncode == 0
            until(lambda: status(folder).get("records", 0) > held["records"], "another record", WAIT_S)
            assert inside("abort", str(folder), "--reason", "enough").returncode == 0
            assert run.wait(WAIT_S) == 4
        finally:
            run.kill()
    gone = inside("pause", str(folder))
    assert gone.returncode == 2
    assert "B-CTRL-001" in gone.stderr
    reader = SessionReader(folder, strict=True)
    controls = [(fields["what"], fields["reason"]) for _, _, fields in reader.events("control")]
    assert controls == [("pause", "door open"), ("resume", ""), ("abort", "enough")]
    assert [kind for kind, _, _ in reader.events() if kind in ("hold", "release")] == ["hold", "release"]
    (given,) = [fields for _, _, fields in reader.events("verdict")]
    assert given["ok"] is not False, given
    assert [one["name"] for one in given["checks"]][:2] == ["frames lost", "frames damaged"]
    told = [json.loads(line)["event"] for line in caught.read_text().splitlines()]
    assert told == ["hold", "release", "error", "end"]
