"""Drivers of QCoDeS, unmodified, on the simulators: every parameter is read, and what was read is set again.

``pip install .[peers]``; without it these tests are skipped. What fails by a fault of theirs, or because the instrument
refuses it too, is listed here with the reason.
"""

import importlib
import warnings
from typing import Any

import pytest
from sim_bench import ADDRESS, complaints, simulated

pytestmark = pytest.mark.peers
pytest.importorskip("qcodes", reason="QCoDeS is not installed: pip install .[peers]")
DRIVERS = {
    "agilent_33250a": ("Keysight", "Keysight33250A"),
    "agilent_34401a": ("agilent", "Agilent34401A"),
    "srs_sr830": ("stanford_research", "SR830"),
}
OF_ANOTHER_MODEL = "a command of the 33500 series, which the 33250A does not have"
EMPTY = "its own buffer was not prepared"
THEIRS = {
    "frequency_mode": OF_ANOTHER_MODEL,
    "pulse_width": OF_ANOTHER_MODEL,
    **dict.fromkeys(("ch1_databuffer", "ch2_databuffer", "ch1_datatrace", "ch2_datatrace"), EMPTY),
}


def parameters(theirs: Any) -> dict[str, Any]:
    """All parameters by name, those of the channels too."""
    found = dict(theirs.parameters)
    for module in theirs.submodules.values():
        for channel in module if hasattr(module, "__iter__") else [module]:
            found |= channel.parameters
    return {name: one for name, one in found.items() if one.gettable}


@pytest.mark.parametrize("name", DRIVERS)
def test_every_parameter_is_read_and_set_again(name: str) -> None:
    folder, kind = DRIVERS[name]
    failed = {}
    with simulated(name) as world, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        made = getattr(importlib.import_module(f"qcodes.instrument_drivers.{folder}"), kind)
        theirs = made(name, ADDRESS, visalib=world.visa_library)
        known = parameters(theirs)
        for what, parameter in known.items():
            theirs.visa_handle.clear()
            complaints(world.instruments[name])
            try:
                value = parameter.get()
                if parameter.settable and what != "timeout" and not isinstance(value, tuple | list):
                    parameter.set(value)
            except Exception as error:
                failed[what] = f"{type(error).__name__}: {error}"
            else:
                if complaints(world.instruments[name]):
                    failed[what] = "the instrument complains"
        theirs.close()
    print(f"{name}: {len(known) - len(failed)} of {len(known)} parameters")
    assert set(failed) == set(known) & set(THEIRS), failed
