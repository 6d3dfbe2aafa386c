"""Row 19: no name in a YAML file, a command or a recorded session leads out of the folders it may name."""

import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from plan_sample import reworded
from rehearsal import ROOT, rehearsed
from soak_campaign import HERE

from bench.commands.recover import recover
from bench.commands.resume import resume
from bench.model.errors import BenchError
from bench.model.lab import find_shipped
from bench.plan import compile_sequence, load_station
from bench.record import SessionWriter

LEADING_OUT = (
    "../evil", "../../evil", "/tmp/evil", "a/../../evil", "..", "~/evil", "evil\\..\\x", "ev\x00il", "evil\n",
)  # fmt: skip
QUOTED = [json.dumps(name) for name in LEADING_OUT]


@pytest.fixture(autouse=True)
def _inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Everything happens in ``inside``; nothing may appear beside it."""
    inside = tmp_path / "inside"
    inside.mkdir()
    monkeypatch.chdir(inside)
    before = everything(tmp_path)
    yield
    assert {path for path in everything(tmp_path) - before if inside not in path.parents} == set()
    assert not Path("/tmp/evil").exists()


def everything(folder: Path) -> set[Path]:
    return {Path(place, name) for place, folders, files in os.walk(folder) for name in (*folders, *files)}


def written(path: Path, *changes: tuple[str, str], source: Path) -> Path:
    path.write_text(reworded(source.read_text(), *changes, once=True))
    return path


def attempt(sequence: Path, station: Path | None) -> str:
    """Compile and run; the code of the refusal, or "" if it ran."""
    try:
        plan = compile_sequence(sequence, None if station is None else load_station(station), {})
        run = rehearsed(Path("out"), plan, seed=1).run
    except BenchError as error:
        return error.code
    assert run.folder.resolve().parent == Path("out").resolve()
    return ""


SEQUENCE = HERE / "soak.yaml"
STATION = ROOT / "stations" / "af_bench_sim.yaml"


@pytest.mark.parametrize("name", QUOTED)
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("sequence: soak", "sequence: {}"),
        ("station: af_bench_sim", "station: {}"),
        ("port_a: ngu_a", "port_a: {}"),
        ("  model: NGU", "  model: {}"),
        ("  serial: SIM-1 ", "  serial: {} "),
        ("frame: {{port_a:", "frame: {{{}:"),
        ("analysis: scale_factor", "analysis: {}"),
    ],
)
def test_names_in_a_sequence(old: str, new: str, name: str) -> None:
    change = (old.replace("{{", "{"), new.replace("{}", name).replace("{{", "{"))
    assert attempt(written(Path("x.yaml"), change, source=SEQUENCE), None).startswith("B-")


@pytest.mark.parametrize("name", QUOTED)
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("station: af_bench_sim", "station: {}"),
        ("driver: fluke_5720a", "driver: {}"),
        ("frame: ngu_a", "frame: {}"),
        ("name: af_converter", "name: {}"),
    ],
)
def test_names_in_a_station(old: str, new: str, name: str) -> None:
    station = written(Path("s.yaml"), (old, new.replace("{}", name)), source=STATION)
    assert attempt(SEQUENCE, station).startswith("B-")


@pytest.mark.parametrize("name", LEADING_OUT)
@pytest.mark.parametrize("kind", ["sequences", "frames", "stations"])
def test_names_of_shipped_files(kind: Any, name: str) -> None:
    with pytest.raises(BenchError, match="B-SHIP-001"):
        find_shipped(kind, name)


@pytest.mark.parametrize("name", ["../evil", "/tmp/evil", "..", "ev\x00il"])
def test_names_inside_a_recorded_session(tmp_path: Path, name: str) -> None:
    """A session may come from anybody; its manifest and the names of its texts write nothing anywhere."""
    manifest = {
        "schema": 1, "session": name, "sequence": name, "station": name, "settings": {}, "plan_sha256": "0",
        "links": {"port_a": f"frames/{name}.yaml"}, "measurement_link": "port_a", "simulated": True,
    }  # fmt: skip
    texts = {"plan.json": "[]", f"sequences/{name}.yaml": "sequence: x\n", f"stations/{name}.yaml": "x", name: "x"}
    folder = Path("session")
    SessionWriter.create(folder, manifest, texts, t_mono_ns=0).close("done")
    for act in (lambda: resume(folder, None, None, False), lambda: recover(folder, None, None)):
        with suppress(BenchError):  # one that nobody foresaw would not be one
            act()


def test_a_link_in_the_place_of_a_session_is_not_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever can write into the folder of sessions must not make the bench write elsewhere."""
    elsewhere = tmp_path / "elsewhere"
    monkeypatch.setattr("bench.run.session.session_name", lambda plan, clock: "known")
    Path("out").mkdir()
    Path("out", "known").symlink_to(elsewhere)
    assert attempt(SEQUENCE, None) in ("", "B-REC-001")
    assert not elsewhere.exists()
