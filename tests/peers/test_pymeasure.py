"""Drivers of PyMeasure, unmodified, on the simulators: every property is read, and what was read is set again.

``pip install .[peers]``; without it these tests are skipped. What fails by a fault of theirs, or because the instrument
refuses it too, is listed here with the reason.
"""

import importlib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from sim_bench import ADDRESS, complaints, simulated

pytestmark = pytest.mark.peers
pytest.importorskip("pymeasure", reason="PyMeasure is not installed: pip install .[peers]")
DRIVERS = {
    "srs_sr830": ("srs", "SR830"),
    "agilent_33250a": ("keysight", "Keysight33250A"),
    "agilent_34401a": ("hp", "HP34401A"),
    "agilent_e3631a": ("keysight", "KeysightE3631A"),
    "pendulum_cnt_91": ("pendulum", "CNT91"),
    "thermotron_3800": ("thermotron", "Thermotron3800"),
}
NO_SCPI = "its base class refuses it for whatever is not SCPI"
THEIRS = {
    **{
        (name, what): NO_SCPI
        for name in ("srs_sr830", "thermotron_3800")
        for what in ("complete", "next_error", "options")
    },
    ("thermotron_3800", "status"): NO_SCPI,
    ("agilent_34401a", "remote_control_enabled"): "there is no such question: it sends 'SYST: '",
    ("agilent_34401a", "remote_lock_enabled"): "there is no such question: it sends 'SYST: '",
    ("agilent_34401a", "gate_time"): "the instrument has a gate time for frequency and period only",
}
NOT_SET = {
    "channel1", "channel2",  # of the SR830: what it reads is two numbers, what it takes is a word
    "current", "voltage", "id", "mode", "setpoint", "temperature",  # of a supply and a chamber: not by this test
}  # fmt: skip


@contextmanager
def opened(name: str) -> Iterator[tuple[Any, Any]]:
    """Their driver and our simulator."""
    from pymeasure.adapters import VISAAdapter

    folder, kind = DRIVERS[name]
    with simulated(name) as world, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        adapter = VISAAdapter(ADDRESS, visa_library=world.visa_library, timeout=3000)
        yield (
            getattr(importlib.import_module(f"pymeasure.instruments.{folder}"), kind)(adapter),
            world.instruments[name],
        )


def properties(kind: type) -> list[str]:
    return [
        name
        for name in dir(kind)
        if not name.startswith("_") and isinstance(found := getattr(kind, name), property) and found.fget is not None
    ]


@pytest.mark.parametrize("name", DRIVERS)
def test_every_property_that_the_instrument_has_is_read(name: str) -> None:
    with opened(name) as (theirs, ours):
        failed = {}
        known = properties(type(theirs))
        for what in known:
            theirs.adapter.connection.clear()
            complaints(ours)
            try:
                getattr(theirs, what)
            except LookupError as error:
                if "read" not in str(error):  # a property that is only set
                    failed[what] = str(error)
            except Exception as error:
                failed[what] = f"{type(error).__name__}: {error}"
            else:
                if complaints(ours):
                    failed[what] = "the instrument complains"
        print(f"{name}: {len(known) - len(failed)} of {len(known)} properties read")
        assert set(failed) == {what for of, what in THEIRS if of == name}, failed


@pytest.mark.parametrize("name", [name for name in DRIVERS if name != "thermotron_3800"])
def test_what_was_read_can_be_set_again(name: str) -> None:
    with opened(name) as (theirs, ours):
        failed = {}
        done = 0
        for what in properties(type(theirs)):
            if getattr(type(theirs), what).fset is None or what in NOT_SET or (name, what) in THEIRS:
                continue
            theirs.adapter.connection.clear()
            complaints(ours)
            try:
                value = getattr(theirs, what)
                setattr(theirs, what, value)
                again = getattr(theirs, what)
            except LookupError as error:
                if "set" not in str(error):  # a property that is only read
                    failed[what] = str(error)
                continue
            except Exception as error:
                failed[what] = f"{type(error).__name__}: {error}"
                continue
            done += 1
            if complaints(ours) or (isinstance(value, float) and again != pytest.approx(value)):
                failed[what] = f"{value!r} set, {again!r} read"
        print(f"{name}: {done} properties set again")
        assert failed == {}
