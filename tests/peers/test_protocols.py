"""The exchanges that PyMeasure's and InstrumentKit's own tests expect, repeated on the simulators.

``$BENCH_PYMEASURE_CHECKOUT`` and ``$BENCH_INSTRUMENTKIT_CHECKOUT`` name checkouts with their tests (the second needs
``$BENCH_INSTRUMENTKIT`` too, with pytest, pytest-mock and hypothesis in it); their tests are run there, with a plugin
that writes down what is expected. A question whose reply the tests make up is asked after that value was set, where
the instrument has a command that sets it, and must then tell the same; any other must have a reply of the same kind.
"""

import importlib.util
import json
import math
import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from sim_bench import alone

pytestmark = pytest.mark.peers
INFINITE = 9.9e37
HERE = Path(__file__).parent
PYMEASURE = ("hp/test_hp34401a", "keysight/test_keysight33250A", "keysight/test_keysightE3631A",
             "pendulum/test_cnt91", "srs/test_sr830")  # fmt: skip
INSTRUMENTKIT = ("test_generic_scpi", "test_hp/test_hp6632b.py", "test_hp/test_hpe3631a.py", "test_srs/test_srs830.py")
MODELS = {
    "SR830": "srs_sr830", "Keysight33250A": "agilent_33250a", "HP34401A": "agilent_34401a",
    "KeysightE3631A": "agilent_e3631a", "CNT91": "pendulum_cnt_91", "SRS830": "srs_sr830", "HP6632b": "hp_6632b",
    "HPe3631a": "agilent_e3631a", "SCPIMultimeter": "agilent_34401a", "SCPIFunctionGenerator": "agilent_33250a",
    "SCPIInstrument": "agilent_34401a",
}  # fmt: skip
MADE_UP = "a reply that their test makes up and no such instrument gives"
OTHER_MODEL = "a command of another model, which this instrument does not have"
BEFORE = "what has to stand before it in a session (other levels, a range, stored readings) their test leaves out"
REASONS = {
    r"HP34401A (CONT|DIOD|FREQ|PER|CURR:AC|VOLT:AC|VOLT:RAT):(NPLC|RES).*": "the function has no such setting",
    r"HP34401A (FRES|RES|VOLT):RES\?": "the instrument has four to six digits of its range, not any resolution",
    r"HP34401A SYST:VERS\?": MADE_UP,
    r"HP34401A FETC\?": BEFORE,
    r"Keysight33250A VOLT 0.001000": "less than the least amplitude into 50 ohm, 10 mV peak to peak",
    r"Keysight33250A VOLT:(HIGH|LOW|OFFS) -?5.000000": BEFORE,
    r"CNT91 :(CONF|FETC):ARR.*": "arrays of frequencies are not simulated",
    r"SCPIInstrument (DISP:(BRIG|CONT)|SYST:LFR).*": OTHER_MODEL,
    r"SCPIInstrument (\*OPC|\*TST)\?": MADE_UP,
    r"SCPIMultimeter SAMP:(SOUR|TIM).*": OTHER_MODEL,
    r"SCPIMultimeter SAMP:COUN\?": MADE_UP,
    r"SCPIMultimeter CONF:CURR:DC \+1.000000E\+01.*": "the largest range is 3 A",
    r"HP6632b SENS:SWE:TINT 1.000000e-05": "less than the least interval, 15.6 us",
    r"SRS830 (SPTS|TRCA)\?.*": BEFORE,
}


def recorded(python: str, checkout: str, tests: list[str], out: Path) -> list[Any]:
    own = os.environ.get("PYTHONPATH", "") if python == sys.executable else ""
    path = os.pathsep.join(filter(None, [str(HERE), checkout, own]))
    environment = {**os.environ, "BENCH_PROTOCOLS": str(out), "PYTHONPATH": path}
    done = subprocess.run(
        [python, "-m", "pytest", "-q", "-p", "record_protocols", "-p", "no:cacheprovider", *tests],
        cwd=checkout, env=environment, capture_output=True, text=True, timeout=300.0, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    return list(json.loads(out.read_text()))


@pytest.fixture(scope="module")
def of_pymeasure(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    checkout = os.environ.get("BENCH_PYMEASURE_CHECKOUT", "")
    if not checkout or importlib.util.find_spec("pymeasure") is None:
        pytest.skip("$BENCH_PYMEASURE_CHECKOUT names no checkout, or PyMeasure is not installed")
    tests = [f"tests/instruments/{name}.py" for name in PYMEASURE]
    return recorded(sys.executable, checkout, tests, tmp_path_factory.mktemp("pymeasure") / "pairs.json")


@pytest.fixture(scope="module")
def of_instrumentkit(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    checkout, python = (os.environ.get(f"BENCH_INSTRUMENTKIT{end}", "") for end in ("_CHECKOUT", ""))
    if not checkout or not python:
        pytest.skip("$BENCH_INSTRUMENTKIT_CHECKOUT names no checkout, or $BENCH_INSTRUMENTKIT no Python")
    tests = [f"tests/{name}" for name in INSTRUMENTKIT]
    return recorded(python, checkout, tests, tmp_path_factory.mktemp("instrumentkit") / "pairs.json")


def numbers(text: str) -> list[float] | None:
    try:
        return [math.inf if abs(float(part)) >= INFINITE else float(part) for part in text.split(",")]
    except ValueError:
        return None


def same(said: str, due: str) -> bool:
    ours, theirs = numbers(said), numbers(due)
    if ours is None or theirs is None:
        return said.strip('"').upper() == due.strip('"').upper()
    return len(ours) == len(theirs) and ours == pytest.approx(theirs, rel=1e-5, abs=1e-12)


def of_same_kind(said: str, due: str) -> bool:
    return (numbers(said) is None) == (numbers(due) is None)


def repeated(instrument: Any, message: str, reply: str | None) -> str:
    """Send one message of theirs; returns what is wrong, "" if nothing is."""
    if reply is None:
        instrument.send(message)
        return "refused" if instrument.complains() else ""
    due = reply.strip()
    if match := re.fullmatch(r"(\*?[:A-Z0-9]+)\?\s*(.*)", message, re.IGNORECASE):
        header, arguments = match.groups()
        instrument.send(f"{header} {', '.join(filter(None, [arguments, due]))}")
        is_set = not instrument.complains()
    else:
        is_set = False
    said = instrument.ask(message)
    if instrument.complains():
        return "refused"
    if said is None:
        return "no reply"
    agree = same(said, due) if is_set else of_same_kind(said, due)
    return "" if agree else f"says {said!r}, {due!r} is due"


def reason_of(kind: str, message: str) -> str:
    return next((why for form, why in REASONS.items() if re.fullmatch(form, f"{kind} {message}")), "")


def repeat_all(protocols: list[Any]) -> tuple[int, Counter[str], list[str]]:
    taken, listed, wrong = 0, Counter[str](), []
    for kind, pairs in protocols:
        with alone(MODELS[kind]) as instrument:
            for message, reply in pairs:
                if message is None or message.upper().startswith("SYST:ERR"):
                    continue
                problem = repeated(instrument, message, reply)
                why = reason_of(kind, message)
                if not problem:
                    taken += 1
                elif why:
                    listed[why] += 1
                else:
                    wrong.append(f"{kind}: {message!r} {problem}")
    return taken, listed, wrong


@pytest.mark.parametrize("project", ["of_pymeasure", "of_instrumentkit"])
def test_every_exchange_is_taken_or_listed(project: str, request: pytest.FixtureRequest) -> None:
    taken, listed, wrong = repeat_all(request.getfixturevalue(project))
    print(f"{project}: {taken} taken, {sum(listed.values())} listed: {dict(listed)}")
    assert taken > 0
    assert wrong == [], "\n".join(sorted(set(wrong)))
