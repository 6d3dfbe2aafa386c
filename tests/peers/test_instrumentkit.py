"""Drivers of InstrumentKit, unmodified, over HiSLIP on a served bench: every property is read.

Its import name is that of our drivers, so it lives in a virtual environment of its own: $BENCH_INSTRUMENTKIT names the
Python of it (InstrumentKit and PyVISA-py installed); without it the test is skipped.
"""

import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from served import Served

from bench.plan import load_station

pytestmark = [pytest.mark.peers, pytest.mark.waits]
PYTHON = os.environ.get("BENCH_INSTRUMENTKIT", "")
WALK = Path(__file__).with_name("walk_instrumentkit.py")
if not PYTHON:
    pytest.skip("$BENCH_INSTRUMENTKIT names no Python with InstrumentKit", allow_module_level=True)

# An SR830 does not know what it inherits from the SCPI instrument; a 6632B has no brightness, contrast and line
# frequency, and the driver raises NotImplementedError for the mode.
THEIRS = {
    "SRS830": {"display_brightness", "display_contrast", "line_frequency", "op_complete", "scpi_version"},
    "HP6632b": {"display_brightness", "display_contrast", "line_frequency", "mode"},
    "SCPIInstrument": {"display_brightness", "display_contrast", "line_frequency"},
}
ROLES = {"SRS830": "lock_in_1", "HP6632b": "supply", "SCPIInstrument": "supply"}


@pytest.fixture(scope="module")
def fog(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served = Served(tmp_path_factory.mktemp("bench"), of="fog_bench_sim")
    try:
        yield served
    finally:
        served.close()


@pytest.mark.parametrize("kind", ROLES)
def test_every_property_that_the_instrument_has_is_read(fog: Served, kind: str) -> None:
    address = load_station(fog.station).instruments[ROLES[kind]].resource
    done = subprocess.run(
        [PYTHON, str(WALK), f"{kind}={address}"], capture_output=True, text=True, check=True, timeout=120.0,
        cwd=WALK.anchor, env={**os.environ, "PYVISA_LIBRARY": "@py", "PYTHONPATH": ""},
    )  # fmt: skip
    (found,) = json.loads(done.stdout).values()
    print(f"{kind}: {found['read']} of {found['read'] + len(found['failed'])} properties read")
    assert set(found["failed"]) == THEIRS[kind], found["failed"]
