"""Drivers of lab folders, asked for by another user than root: a program of its own, which gives up its rights.

``lab_as_user.py UID FOLDER JSON`` becomes that user and goes to each folder of a list ``[[folder, driver], ...]``; it
prints ``[[what, where], ...]``: name of the class that was loaded, or code and place of the refusal. What is installed
is imported before, through a lab in the new FOLDER, since the user may not be able to read it.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

from own_lab import DRIVER, copied

from bench.model.drivers import driver_class
from bench.model.errors import InstallationError


def become(user: int) -> None:
    """Give up root for good: the saved ids too, and every group."""
    os.setgroups([])
    os.setresgid(user, user, user)
    os.setresuid(user, user, user)


def asked(folder: str, driver: str) -> tuple[str, str]:
    """Return what a user gets who names a driver in a lab folder."""
    os.chdir(folder)
    try:
        return driver_class(driver).__name__, ""
    except InstallationError as error:
        return error.code, error.where


if __name__ == "__main__":
    user, first, cases = int(sys.argv[1]), Path(sys.argv[2]), json.loads(sys.argv[3])
    asked(str(copied(first)), Path(DRIVER).stem)
    asked(str(first), "hp_3458a")
    become(user)
    print(json.dumps([asked(folder, driver) for folder, driver in cases]))
