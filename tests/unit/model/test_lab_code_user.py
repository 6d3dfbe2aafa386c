"""Code of a lab folder as a user who is not root meets it: the tests run as root, so a child process becomes one."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from own_lab import DRIVER, copied

pytestmark = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can become another user"
)
PROGRAM = Path(__file__).resolve().parents[2] / "support" / "lab_as_user.py"
USER, OTHER, ROOT = 4242, 4343, 0
NAME = Path(DRIVER).stem
LOADED = ("ExampleT100", "")


def owned(lab: Path, user: int) -> None:
    for path in (lab, *lab.rglob("*")):
        os.chown(path, user, user, follow_symlinks=False)


def others_file(lab: Path) -> Path:
    os.chown(lab / DRIVER, OTHER, OTHER)
    return lab / DRIVER


def others_code_folder(lab: Path) -> Path:
    os.chown(lab / "instruments", OTHER, OTHER)
    return lab / "instruments"


def others_lab(lab: Path) -> Path:
    owned(lab, OTHER)
    return lab


def parent_of_everybody(lab: Path) -> Path:
    lab.parent.chmod(0o777)
    return lab.parent


def parent_of_a_group(lab: Path) -> Path:
    lab.parent.chmod(0o775)
    return lab.parent


def parent_of_another(lab: Path) -> Path:
    os.chown(lab.parent, OTHER, OTHER)
    return lab.parent


def file_of_everybody(lab: Path) -> Path:
    (lab / DRIVER).chmod(0o666)
    return lab / DRIVER


def link_to_anothers_file(lab: Path) -> Path:
    outside = lab.parent / "outside.py"
    shutil.move(lab / DRIVER, outside)
    os.chown(outside, OTHER, OTHER)
    (lab / DRIVER).symlink_to(outside)
    os.lchown(lab / DRIVER, USER, USER)
    return lab / DRIVER


def link_to_anothers_folder(lab: Path) -> Path:
    outside = lab.parent / "outside"
    shutil.move(lab / "instruments", outside)
    os.chown(outside, OTHER, OTHER)
    (lab / "instruments").symlink_to(outside)
    os.lchown(lab / "instruments", USER, USER)
    return lab / "instruments"


REFUSED: tuple[Callable[[Path], Path], ...] = (
    others_file, others_code_folder, others_lab, parent_of_everybody, parent_of_a_group, parent_of_another,
    file_of_everybody, link_to_anothers_file, link_to_anothers_folder,
)  # fmt: skip


def of_the_user(lab: Path) -> None:
    return None


def of_root(lab: Path) -> None:
    owned(lab, ROOT)


def below_a_sticky_folder(lab: Path) -> None:
    lab.parent.chmod(0o1777)


ACCEPTED: tuple[Callable[[Path], None], ...] = (of_the_user, of_root, below_a_sticky_folder)


@pytest.fixture(scope="module")
def answers() -> Iterator[dict[str, tuple[str, str, str]]]:
    """Return what the user got in each lab, and which place was made wrong; one child process asks for all."""
    with tempfile.TemporaryDirectory() as top:  # folders of pytest are closed to everybody else
        Path(top).chmod(0o755)
        cases: dict[str, tuple[Path, str, str]] = {}
        for arrange in (*ACCEPTED, *REFUSED):
            lab = copied(Path(top) / arrange.__name__ / "lab")
            lab.parent.chmod(0o755)
            owned(lab.parent, USER)
            cases[arrange.__name__] = (lab, NAME, str(arrange(lab) or ""))
        shipped = copied(Path(top) / "shipped" / "lab")
        shutil.copy(shipped / DRIVER, shipped / "instruments" / "hp_3458a.py")
        owned(shipped.parent, USER)
        cases["shipped"] = (shipped, "hp_3458a", str(shipped / "instruments" / "hp_3458a.py"))
        asked = json.dumps([(str(lab), driver) for lab, driver, _ in cases.values()])
        command = [sys.executable, str(PROGRAM), str(USER), str(Path(top) / "first"), asked]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        got = json.loads(done.stdout)
        yield {name: (*said, wrong) for (name, (_, _, wrong)), said in zip(cases.items(), got, strict=True)}


@pytest.mark.parametrize("arrange", ACCEPTED, ids=lambda arrange: arrange.__name__)
def test_what_only_the_user_or_root_can_have_written_is_loaded(
    answers: dict[str, tuple[str, str, str]], arrange: Callable[[Path], None]
) -> None:
    assert answers[arrange.__name__][:2] == LOADED


@pytest.mark.parametrize("arrange", REFUSED, ids=lambda arrange: arrange.__name__)
def test_what_somebody_else_can_have_written_is_refused(
    answers: dict[str, tuple[str, str, str]], arrange: Callable[[Path], Path]
) -> None:
    code, where, wrong = answers[arrange.__name__]
    assert (code, where) == ("B-LAB-004", wrong)


def test_a_driver_with_an_installed_name_is_refused(answers: dict[str, tuple[str, str, str]]) -> None:
    code, where, wrong = answers["shipped"]
    assert (code, where) == ("B-LAB-005", wrong)
