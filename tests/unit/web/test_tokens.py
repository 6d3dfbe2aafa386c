"""Tokens: drawn once, kept hashed, in a file of its owner."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path

import pytest

from bench.model.clock import VirtualClock
from bench.model.errors import InputError
from bench.web.security.audit import Audit
from bench.web.security.tokens import FILE, MOST_IN_ALL, OPERATOR, VIEWER, LoginLimit, obtain_tokens, private_folder


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_made_once_and_kept_hashed(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "inertial-bench"
    tokens, clear = obtain_tokens(folder)
    assert set(clear) == {VIEWER, OPERATOR}
    assert all(len(token) >= 32 for token in clear.values())
    assert (mode(folder), mode(folder / FILE)) == (0o700, 0o600)
    kept = (folder / FILE).read_text()
    assert not [token for token in clear.values() if token in kept]
    again, shown = obtain_tokens(folder)
    assert (again, shown) == (tokens, {})
    assert [path.name for path in folder.iterdir()] == [FILE]


def test_a_token_opens_its_role_and_nothing_else_does(tmp_path: Path) -> None:
    tokens, clear = obtain_tokens(tmp_path / "a")
    assert tokens.role_of(clear[VIEWER]) == VIEWER
    assert tokens.role_of(clear[OPERATOR]) == OPERATOR
    for wrong in ("", clear[VIEWER][:-1], clear[VIEWER] + "x", tokens.viewer, tokens.operator, "\ud800", "0" * 100_000):
        assert tokens.role_of(wrong) is None


def test_rotating_makes_everything_new(tmp_path: Path) -> None:
    before, old = obtain_tokens(tmp_path / "a")
    after, new = obtain_tokens(tmp_path / "a", rotate=True)
    assert set(old.values()).isdisjoint(new.values())
    assert before.cookie_key != after.cookie_key
    assert after.role_of(old[OPERATOR]) is None
    assert mode(tmp_path / "a" / FILE) == 0o600


@pytest.mark.parametrize("wrong", [0o644, 0o640, 0o604, 0o660])
def test_a_file_that_others_may_use_is_refused_b_web_006(tmp_path: Path, wrong: int) -> None:
    obtain_tokens(tmp_path / "a")
    (tmp_path / "a" / FILE).chmod(wrong)
    with pytest.raises(InputError) as raised:
        obtain_tokens(tmp_path / "a")
    assert raised.value.code == "B-WEB-006"
    assert f"{wrong:04o}" in raised.value.message
    obtain_tokens(tmp_path / "a", rotate=True)
    assert mode(tmp_path / "a" / FILE) == 0o600


def test_what_is_made_for_it_is_the_owners_alone_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        obtain_tokens(tmp_path / ".config" / "inertial-bench")
        Audit(tmp_path / ".config" / "inertial-bench", VirtualClock()).write("login")
    finally:
        os.umask(before)
    folder = tmp_path / ".config" / "inertial-bench"
    assert [mode(one) for one in (folder.parent, folder)] == [0o700, 0o700]
    assert {mode(one) for one in folder.iterdir()} == {0o600}


def test_a_folder_that_others_may_change_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a").chmod(0o770)
    with pytest.raises(InputError) as raised:
        obtain_tokens(tmp_path / "a")
    assert raised.value.code == "B-WEB-006"


@pytest.mark.parametrize("content", ["", "{", "[]", '{"salt": 1}', '{"salt": "zz", "viewer": "", "operator": ""}'])
def test_a_file_that_is_none_of_ours_b_web_007(tmp_path: Path, content: str) -> None:
    obtain_tokens(tmp_path / "a")
    (tmp_path / "a" / FILE).write_text(content)
    with pytest.raises(InputError) as raised:
        obtain_tokens(tmp_path / "a")
    assert raised.value.code == "B-WEB-007"
    assert "--rotate" in raised.value.next_step


def test_an_emptied_hash_opens_nothing(tmp_path: Path) -> None:
    obtain_tokens(tmp_path / "a")
    path = tmp_path / "a" / FILE
    path.write_text(json.dumps({**json.loads(path.read_text()), "cookie_key": ""}))
    with pytest.raises(InputError):
        obtain_tokens(tmp_path / "a")


def test_a_place_that_cannot_hold_it_b_web_007(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("a file")
    with pytest.raises(InputError) as raised:
        obtain_tokens(tmp_path / "a")
    assert raised.value.code == "B-WEB-007"
    elsewhere = tmp_path / "elsewhere.json"
    elsewhere.write_text("{}")
    elsewhere.chmod(0o600)
    (tmp_path / "b").mkdir(mode=0o700)
    (tmp_path / "b" / FILE).symlink_to(elsewhere)
    with pytest.raises(InputError):
        obtain_tokens(tmp_path / "b")


def test_where_they_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert private_folder() == tmp_path / "inertial-bench"
    monkeypatch.setenv("HOME", str(tmp_path))
    for relative in ("", "here"):
        monkeypatch.setenv("XDG_CONFIG_HOME", relative)
        assert private_folder() == tmp_path / ".config" / "inertial-bench"


def test_wrong_tokens_have_to_wait() -> None:
    clock = VirtualClock()
    limit = LoginLimit(clock)
    for _ in range(5):
        assert limit.wait_s("a") == 0
        limit.failed("a")
        clock.sleep(1.0)
    assert 55 <= limit.wait_s("a") <= 60
    assert limit.wait_s("b") == 0
    clock.sleep(limit.wait_s("a"))
    assert limit.wait_s("a") == 0


def test_wrong_tokens_from_everywhere_have_to_wait() -> None:
    clock = VirtualClock()
    limit = LoginLimit(clock)
    for number in range(10_000):
        limit.failed(str(number))
    assert limit.wait_s("another") > 0
    assert len(limit._failures) == MOST_IN_ALL
    clock.sleep(61.0)
    assert limit.wait_s("another") == 0


def test_the_audit_is_private_bounded_and_loses_nothing_recent(tmp_path: Path) -> None:
    audit = Audit(tmp_path, VirtualClock(), largest=1000)
    for number in range(100):
        audit.write("command", name="kim\n", number=number)
    files = sorted(path.name for path in tmp_path.iterdir())
    assert files == ["serve.1.jsonl", "serve.2.jsonl", "serve.3.jsonl", "serve.4.jsonl", "serve.jsonl"]
    assert all(path.stat().st_size <= 1000 and mode(path) == 0o600 for path in tmp_path.iterdir())
    order = [f"serve.{number}.jsonl" for number in (4, 3, 2, 1)] + ["serve.jsonl"]
    lines = [json.loads(line) for name in order for line in (tmp_path / name).read_text().splitlines()]
    numbers = [line["number"] for line in lines]
    assert numbers == list(range(numbers[0], 100))
    assert lines[0]["t_utc"] == "2000-01-01T00:00:00Z"


def test_an_audit_that_cannot_be_written_is_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    audit = Audit(tmp_path / "not_there", VirtualClock())
    audit.write("command")
    audit.write("command")
    assert capsys.readouterr().err.count("is not written") == 1
