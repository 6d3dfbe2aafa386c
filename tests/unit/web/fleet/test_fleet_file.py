"""``fleet.yaml``: what it says, and one clear error with its place for each mistake."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from bench.commands.requests import ServeRequest
from bench.commands.serve import serve
from bench.model.errors import InputError
from bench.web.fleet.fleet_file import load_fleet

TOKEN = "a" * 32
REMOTE = "  - {name: one, url: 'https://one.example.org', token_env: TOKEN_ONE}\n"
ENVIRONMENT = {"TOKEN_ONE": TOKEN, "EMPTY": "", "WORDS": "not a token"}


def written(folder: Path, text: str) -> Path:
    path = folder / "fleet.yaml"
    path.write_text(text)
    return path


def test_the_example_of_the_page_is_taken(tmp_path: Path) -> None:
    page = (Path(__file__).parents[4] / "docs" / "fleet.md").read_text(encoding="utf-8")
    kept(tmp_path).rename(tmp_path / "bench-1.token")
    (tmp_path / "sessions").mkdir()
    path = written(tmp_path, page.split("```yaml\n")[1].split("```")[0])
    benches = load_fleet(path, {"BENCH_2_TOKEN": TOKEN})
    assert [bench.name for bench in benches] == ["bench-1", "bench-2", "this machine"]


def refused(folder: Path, lines: str) -> str:
    path = written(folder, f"benches:\n{lines}")
    with pytest.raises(InputError) as raised:
        load_fleet(path, ENVIRONMENT)
    assert raised.value.exit_status == 2
    return str(raised.value).replace(str(path), "fleet.yaml")


def kept(folder: Path, text: str = TOKEN, mode: int = 0o600) -> Path:
    path = folder / "one.token"
    path.write_text(text)
    path.chmod(mode)
    return path


def test_what_it_says(tmp_path: Path) -> None:
    kept(tmp_path, f"{TOKEN}\n")
    (tmp_path / "sessions").mkdir()
    lines = (
        "benches:\n"
        f"{REMOTE}"
        "  - {name: Bench 2, place: room 2.14, url: 'http://127.0.0.1:8321/', token_file: one.token}\n"
        "  - {name: 벤치, folder: sessions}\n"
    )
    one, two, three = load_fleet(written(tmp_path, lines), ENVIRONMENT)
    assert (one.name, one.url, one.token, one.folder) == ("one", "https://one.example.org", TOKEN, None)
    assert (two.place, two.url, two.token) == ("room 2.14", "http://127.0.0.1:8321", TOKEN)
    assert (three.name, three.url, three.folder) == ("벤치", "", tmp_path / "sessions")
    assert two.where == f"{tmp_path / 'fleet.yaml'}:3:6"
    assert TOKEN not in repr(one)


NOT_TAKEN = """http://one.example.org http://192.0.2.7:8321 ftp://one.example.org one.example.org
    https://kim:secret@one.example.org https://one.example.org/runs/x https://one.example.org?token=x
    https://one.example.org:99999"""
TOKENS = {
    "token_env: MISSING": "the variable MISSING is empty",
    "token_env: EMPTY": "the variable EMPTY is empty",
    "token_env: WORDS": "the variable WORDS holds no token",
    "token_file: no.token": "cannot be read: No such file",
    "token_file: .": "cannot be read: ",
}
NO_BENCH = """name: one
    name: one, url: 'https://one.example.org'
    name: one, url: 'https://one.example.org', token_env: A, token_file: b
    name: one, folder: a, token_env: A
    name: one, folder: a, url: 'https://one.example.org', token_env: A
    name: '', folder: a
    name: one, folder: a, token: secret"""
WRONG = [
    ("name: one, folder: nowhere", "B-FLEET-004: fleet.yaml:2:17: ", ""),
    *((f"name: one, url: '{url}', token_env: A", "B-FLEET-001: fleet.yaml:2:17: ", "") for url in NOT_TAKEN.split()),
    *((f"name: a, url: 'https://a.org', {key}", "B-FLEET-003: fleet.yaml:2:37: ", TOKENS[key]) for key in TOKENS),
    *((line.strip(), "B-YAML-01", ": fleet.yaml:2:") for line in NO_BENCH.splitlines()),
]


@pytest.mark.parametrize(("line", "begins", "words"), WRONG)
def test_a_line_that_is_not_taken_has_its_code_and_its_place(
    tmp_path: Path, line: str, begins: str, words: str
) -> None:
    said = refused(tmp_path, f"  - {{{line}}}\n")
    assert said.startswith(f"error {begins}")
    assert words in said
    assert "kim:secret" not in said


def test_a_bench_that_stands_there_twice_b_fleet_002(tmp_path: Path) -> None:
    first, second = refused(tmp_path, f"{REMOTE}{REMOTE.replace('org', 'org/')}").splitlines()
    assert first.startswith("error B-FLEET-002: fleet.yaml:3:6: name 'one' stands there twice, first at fleet.yaml:2:6")
    assert second.startswith("error B-FLEET-002: fleet.yaml:3:17: url 'https://one.example.org/'")
    (tmp_path / "a").mkdir()
    folders = "  - {name: one, folder: a}\n  - {name: two, folder: a}\n"
    assert "fleet.yaml:3:17: folder 'a' stands there twice" in refused(tmp_path, folders)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have no owners here")
@pytest.mark.parametrize(("text", "mode", "words"), [(TOKEN, 0o640, "has mode 0640"), ("", 0o600, "is empty")])
def test_the_file_of_a_token_is_for_its_owner_b_fleet_003(tmp_path: Path, text: str, mode: int, words: str) -> None:
    kept(tmp_path, text, mode)
    said = refused(tmp_path, "  - {name: one, url: 'https://one.example.org', token_file: one.token}\n")
    assert "B-FLEET-003" in said
    assert words in said
    assert TOKEN not in said


def test_all_mistakes_are_said_at_once_in_order(tmp_path: Path) -> None:
    lines = "  - {name: a, folder: nowhere}\n  - {name: a, url: 'http://x.example.org', token_env: A}\n"
    said = refused(tmp_path, lines).splitlines()
    assert [line.split(": ")[0] for line in said] == ["error B-FLEET-004", "error B-FLEET-002", "error B-FLEET-001"]


@pytest.mark.parametrize("option", [{"out": Path("sessions")}, {"mqtt": "mqtt://127.0.0.1"}])
def test_what_belongs_to_one_bench_b_fleet_005(tmp_path: Path, option: dict[str, object]) -> None:
    with pytest.raises(InputError) as raised:
        serve(ServeRequest(fleet=written(tmp_path, f"benches:\n{REMOTE}"), **option))  # type: ignore[arg-type]
    assert raised.value.code == "B-FLEET-005"
    assert next(iter(option)) in raised.value.where
