"""Programs of other people, unmodified, on the simulators: what they send is taken, what they read is a number.

``$BENCH_PROGRAMS`` names a folder of checkouts, ``OWNER+NAME`` each; without it the test is skipped. With PyMeasure
0.16.0 and QCoDeS 0.58.0 (files of their own here) and plain questions by easy-scpi 0.1.7, these are what was tried
last, each at its commit.
"""

import importlib
import os
import sys
from operator import attrgetter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import pyvisa
from sim_bench import ADDRESS, simulated

pytestmark = pytest.mark.peers
FOLDER = Path(os.environ.get("BENCH_PROGRAMS", "nowhere"))
if not FOLDER.is_dir():
    pytest.skip("$BENCH_PROGRAMS names no folder", allow_module_level=True)
COMMITS = {
    "PhilippCo+testgear": "f36fc05304cae78bd1c988987632ee244ab50156",
    "tin-+teckit": "957b4f1ef9eccd965c09900a15c16f1dbc9f0c8b",
    "SweepMe+instrument-drivers": "0751b5232c9b2e2ddde61663429c79be46b7efda",
    "joewhalen+keysight_53230A": "1c28fdef504e08ebf516aafb7246e4c975e2a1fb",
    "python-ivi+python-ivi": "cfa45ceade0758debe4bc24ba4c8195222cad1e2",
}
READ, SET = "get_reading", "__setattr__"
SWEEPME = {"RouteOut": "Front", "Resolution": "8 Digits", "Range": "Auto", "NPLC": "Slow (10)", "Auto-Zero": "On",
           "Display": "Off", "Port": ADDRESS, "Mode": "Current DC"}  # fmt: skip
PROGRAMS: list[tuple[str, str, str, str, list[tuple[Any, ...]]]] = [
    ("hp_3458a", "PhilippCo+testgear", "testgear.HPAK.HP3458A", "HP3458A", [
        ("conf_function_DCI", 0.1, 1), (READ,), ("conf_function_DCV", 10, 1), (READ,), ("conf_function_DCV",),
        ("conf_function_ACV", 1, 1), ("conf_function_OHM4W", 1000, 1), (READ,), ("cleanup",)]),
    ("hp_3458a", "tin-+teckit", "devices.hp3458", "dmm_meter", [
        ("set_dcv_range", 10), ("trigger",), ("read_val",), ("set_ohmf_range", 1e4), ("set_dci_range", 0.1),
        ("trigger",), ("read_val",), ("set_acvs_range", 1.0), ("init_inst_fres",), ("get_temp",), ("acaldcv",)]),
    ("hp_3458a", "SweepMe+instrument-drivers", "src.Logger-Keysight_3458A.main", "Device", [
        ("get_GUIparameter", SWEEPME), ("initialize",), ("configure",), ("measure",), ("call",), ("unconfigure",)]),
    ("agilent_34970a", "PhilippCo+testgear", "testgear.HPAK.A34970A", "A34970A", [
        ("reset",), ("conf_function_DCV", 101), ("conf_function_temperature", None, 1, True, True, 102), ("get_scan",),
        ("conf_pt100", 103), ("get_scanlist",), ("set_monitor_channel", 101), ("get_monitor_state",), (READ, 101)]),
    ("agilent_53230a", "joewhalen+keysight_53230A", "counter", "Counter", []),
    ("agilent_34401a", "python-ivi+python-ivi", "ivi.agilent.agilent34401A", "agilent34401A", [
        ("identity.instrument_model",), (SET, "measurement_function", "dc_volts"), (SET, "range", 10), ("auto_range",),
        (SET, "resolution", 1e-3), ("resolution",), ("measurement.read", 1), ("measurement.initiate",),
        ("measurement.fetch", 1), ("trigger.delay_auto",), (SET, "measurement_function", "four_wire_resistance"),
        ("trigger.multi_point.configure", 1, 2, "immediate", 0), ("utility.self_test",), ("utility.reset",),
        ("measurement.abort",)]),
    ("agilent_e3631a", "python-ivi+python-ivi", "ivi.agilent.agilentE3631A", "agilentE3631A", [
        (SET, "couple_tracking_enabled", False), ("_set_output_voltage_level", 1, 12), ("_get_output_voltage_level", 2),
        ("_set_output_current_limit", 0, 1.0), ("_set_output_enabled", 0, True), ("_output_measure", 1, "voltage"),
        ("_get_output_ovp_enabled", 0), ("utility.self_test",), ("_memory_save", 1), ("trigger.initiate",)]),
]  # fmt: skip
WAY_ROUND: dict[str, Any] = {  # what they import besides, and we have not: of the screen, of other interfaces
    "six": SimpleNamespace(PY2=False), "zmq": SimpleNamespace(PUB=0, Context=lambda: SimpleNamespace(
        socket=lambda kind: SimpleNamespace(bind=lambda address: None))),
    "config": SimpleNamespace(PORT="0", USB_ID=ADDRESS, GATE_TIME=0.1),
    "pysweepme.EmptyDeviceClass": SimpleNamespace(EmptyDevice=type("EmptyDevice", (), {})),
    "pysweepme": SimpleNamespace(),
}  # fmt: skip
NINE_DIGITS = "NDIG 9: the most is 8 (manual, NDIG)"
NO_MONITOR = "the monitor is not simulated"
REFUSED = {
    **{("dmm_meter", call): NINE_DIGITS for call in ("set_dcv_range", "set_dci_range", "init_inst_fres")},
    ("A34970A", "conf_function_temperature"): "CONF:TEMP without the kind of probe, which the instrument demands",
    ("A34970A", "conf_pt100"): "resistance thermometers are not simulated",
    **{("A34970A", call): NO_MONITOR for call in ("set_monitor_channel", "get_monitor_state", READ)},
    ("agilent34401A", "measurement.abort"): "ABORt, which a 34401A does not have",
    ("agilentE3631A", "_get_output_ovp_enabled"): "VOLT:PROT, which an E3631A does not have",
    ("agilentE3631A", "_memory_save"): "stored states are not simulated",
    ("agilentE3631A", "trigger.initiate"): "triggered levels are not simulated",
}


@pytest.mark.filterwarnings("ignore")  # of programs that are older than this Python
@pytest.mark.parametrize(("name", "folder", "module", "kind", "calls"), PROGRAMS)
def test_a_program_runs(
    name: str, folder: str, module: str, kind: str, calls: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for imported in [word for word in sys.modules if word.partition(".")[0] == module.partition(".")[0]]:
        monkeypatch.delitem(sys.modules, imported)
    monkeypatch.syspath_prepend(FOLDER / folder)
    monkeypatch.chdir(tmp_path)
    Path("teckit.conf").write_text("[teckit]\ninterface = visa\n")
    with simulated(name) as world:
        manager = pyvisa.ResourceManager(world.visa_library)
        opened = lambda *_, **__: manager.open_resource(ADDRESS, timeout=60_000)  # noqa: E731
        library = SimpleNamespace(ResourceManager=lambda *_: SimpleNamespace(open_resource=opened))
        for word, stand_in in {**WAY_ROUND, "pyvisa": library, "visa": library}.items():
            monkeypatch.setitem(sys.modules, word, stand_in)
        made = getattr(importlib.import_module(module), kind)
        arguments = {"dmm_meter": (22, 1, "x")}.get(kind, (ADDRESS, True) if folder.startswith("python-ivi") else ())
        theirs = made(*arguments)
        theirs.port = opened()
        device, failed = world.instruments[name], {}
        for call, *given in calls:
            try:
                found = attrgetter(call)(theirs)
                print(name, call, found(*given) if callable(found) else found)
            except Exception as error:
                failed[call] = f"{type(error).__name__}: {error}"
            if told := device.errors:
                failed[call], device.errors = f"{told} {failed.get(call, '')}", type(told)()
    assert set(failed) == {call for of, call in REFUSED if of == kind}, failed
