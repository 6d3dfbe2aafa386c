"""The documents say what the drivers do."""

import re
from pathlib import Path

import pytest
from known_drivers import IDENTIFY

ROOT = Path(__file__).parents[2]
CODE = re.compile(r"B-INST-\d{3}")


def codes_in(paths: list[Path]) -> set[str]:
    return {code for path in paths for code in CODE.findall(path.read_text(encoding="utf-8"))}


def test_every_code_is_listed_and_tested() -> None:
    used = codes_in(sorted((ROOT / "instruments").glob("*.py")))
    lines = (ROOT / "docs/errors.md").read_text(encoding="utf-8").splitlines()
    table = [line for line in lines if line.startswith("| B-INST-")]
    listed = [row.split("|")[1].strip() for row in table]
    assert sorted(used) == listed
    assert all(len(row.split("|")) == 6 for row in table)
    asserted = re.findall(
        r'code == "(B-INST-\d{3})"',
        "".join(path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parent.glob("test_*.py"))),
    )
    assert used <= set(asserted)


@pytest.mark.parametrize("name", sorted(IDENTIFY))
def test_every_driver_is_listed(name: str) -> None:
    listed = (ROOT / "docs/supported-instruments.md").read_text(encoding="utf-8")
    assert f"| `{name}` |" in listed
    assert (ROOT / f"tests/protocol/test_{name}.py").is_file()
