"""Each driver has a table of its commands, and its page in docs/instruments is written from it (``make manuals``)."""

import re
import runpy
from pathlib import Path

import pytest

from bench.model.drivers import manual_of

TOP = Path(__file__).resolve().parents[2]
page = runpy.run_path(str(TOP / "docs" / "site" / "manuals.py"))["page"]
DRIVERS = sorted(path.stem for path in (TOP / "instruments").glob("*.yaml"))


def test_every_driver_has_a_table_and_every_page_a_driver() -> None:
    drivers = [path.stem for path in (TOP / "instruments").glob("*.py") if "\nDRIVER = " in path.read_text("utf-8")]
    assert sorted(drivers) == DRIVERS
    assert sorted(path.stem for path in (TOP / "docs" / "instruments").glob("*.md")) == DRIVERS


@pytest.mark.parametrize("driver", DRIVERS)
def test_the_table_makes_sense_and_the_page_is_written_from_it(driver: str) -> None:
    manual = manual_of(driver)
    assert manual is not None
    assert (TOP / "docs" / "instruments" / f"{driver}.md").read_text("utf-8") == page(driver, manual)
    for form, command in manual.commands.items():
        assert any(key in command.source for key in manual.sources), form
        if command.reply:
            re.compile(command.reply)
        if command.example:
            assert manual.find(command.example) == form
        if "?" in form:
            assert command.reply, form
            assert command.touch == "asks", form
