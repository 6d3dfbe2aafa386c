"""Run by the Python of a virtual environment with InstrumentKit: KIND=ADDRESS ...; prints what could not be read."""

import json
import sys

import pyvisa

sys.modules["visa"] = pyvisa  # the name under which InstrumentKit looks for it
import instruments  # noqa: E402 - InstrumentKit owns this name

KINDS = {
    "SRS830": lambda: instruments.srs.SRS830,
    "HP6632b": lambda: instruments.hp.HP6632b,
    "SCPIInstrument": lambda: instruments.generic_scpi.SCPIInstrument,
}


def walked(kind, address):
    """Number of properties that were read, and the errors of the others."""
    instrument = KINDS[kind]().open_visa(address)
    instrument._file._conn.timeout = 2000
    read, failed = 0, {}
    for name in dir(type(instrument)):
        found = getattr(type(instrument), name)
        if name.startswith("_") or not isinstance(found, property) or found.fget is None:
            continue
        try:
            getattr(instrument, name)
            read += 1
        except Exception as error:
            failed[name] = f"{type(error).__name__}: {error}"
            instrument._file._conn.clear()
    return {"read": read, "failed": failed}


print(json.dumps({word: walked(*word.split("=", 1)) for word in sys.argv[1:]}))
