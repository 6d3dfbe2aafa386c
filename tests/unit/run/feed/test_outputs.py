"""The state of the bench: what replies prove, what commands only suspect, and how long either is believed."""

from __future__ import annotations

import json
from typing import Any

import pytest

from bench.run.feed.outputs import LAST_LOOK_S, Outputs, bench_in_words

GOOD_FOR_S = 150.0
PLACES = {
    "calibrator": ("fluke_5720a", "GPIB0::4::INSTR"),
    "switch": ("keithley_7002", "GPIB0::7::INSTR"),
    "supply": ("hp_6632b", "GPIB0::5::INSTR"),
    "chamber": ("thermotron_3800", "GPIB0::1::INSTR"),
    "dmm": ("hp_3458a", "GPIB0::22::INSTR"),
}
OFF = (
    ("calibrator", "ISR?", "0"), ("switch", ":CLOS:STAT?", "(@)"), ("supply", "OUTP?", "0"), ("chamber", "MODE?", "0"),
)  # fmt: skip


def bench() -> Outputs:
    return Outputs(PLACES, GOOD_FOR_S)


def asked(outputs: Outputs, role: str, question: str, reply: str, t: float) -> None:
    outputs.on_traffic(role, "tx", question, t)
    outputs.on_traffic(role, "rx", reply, t + 0.01)


def all_off(t: float = 0.0) -> Outputs:
    outputs = bench()
    for line in OFF:
        asked(outputs, *line, t)
    return outputs


def parts(document: dict[str, Any]) -> dict[str, str]:
    return {part["role"]: part["state"] for part in document["parts"]}


def test_all_are_off_when_the_last_of_them_has_said_so_and_nothing_is_known_before() -> None:
    outputs = bench()
    document = outputs.document(0.0)
    assert (document["state"], document["confirmed_utc_s"]) == ("unknown", None)
    assert parts(document) == dict.fromkeys(("calibrator", "switch", "supply", "chamber"), "unknown")  # a meter reads
    for number, line in enumerate(OFF):
        assert outputs.document(float(number))["state"] == "unknown"
        asked(outputs, *line, float(number))
    document = outputs.document(4.0)
    assert (document["state"], document["confirmed_utc_s"]) == ("off", pytest.approx(0.01))  # the oldest of the replies
    json.dumps(document, allow_nan=False)


def test_a_command_switches_on_at_once_and_off_only_when_that_is_confirmed() -> None:
    outputs = all_off()
    outputs.on_traffic("calibrator", "tx", "OPER", 1.0)
    assert outputs.document(1.0)["state"] == "energised"
    asked(outputs, "calibrator", "ISR?", str(1 | 1 << 12), 2.0)
    asked(outputs, "calibrator", "OUT?", "2.0E-02,A,0E+00", 2.0)
    document = outputs.document(3.0)
    assert (document["state"], document["confirmed_utc_s"]) == ("energised", pytest.approx(2.01))
    assert bench_in_words(document) == "ENERGISED: calibrator 20 mA"
    outputs.on_traffic("calibrator", "tx", "STBY", 4.0)
    assert outputs.document(4.0)["state"] == "energised"
    asked(outputs, "calibrator", "ISR?", "0", 5.0)
    assert outputs.document(5.0)["state"] == "off"


def test_a_closed_route_is_told_and_is_no_energy_of_its_own() -> None:
    outputs = all_off()
    asked(outputs, "switch", ":CLOS:STAT?", "(@1!2!7)", 1.0)
    document = outputs.document(1.0)
    assert (document["state"], parts(document)["switch"]) == ("off", "on")
    assert document["parts"][1]["figures"][0]["text"] == "1!2!7"


def test_a_reply_that_is_too_old_is_not_known_any_more() -> None:
    outputs = all_off()
    assert outputs.document(GOOD_FOR_S)["state"] == "off"
    assert outputs.document(GOOD_FOR_S + 0.1)["state"] == "unknown"
    asked(outputs, "supply", "OUTP?", "1", 200.0)
    assert outputs.document(200.0 + GOOD_FOR_S)["state"] == "energised"
    assert outputs.document(201.0 + GOOD_FOR_S)["state"] == "unknown"


def test_the_end_counts_by_its_last_look() -> None:
    outputs = all_off(1000.0)
    assert outputs.document(9e6, ended_utc_s=1001.0)["state"] == "off"
    asked(outputs, "calibrator", "ISR?", "0", 1000.0 + LAST_LOOK_S)
    late = outputs.document(9e6, ended_utc_s=1001.0 + LAST_LOOK_S)  # only the calibrator has answered at the end
    assert late["state"] == "unknown"
    assert parts(late) == {"calibrator": "off", "switch": "unknown", "supply": "unknown", "chamber": "unknown"}


def test_a_command_of_nobodys_table_and_a_reply_of_another_form_make_it_unknown() -> None:
    outputs = all_off()
    outputs.on_traffic("supply", "tx", "OUTP 1", 1.0)  # by hand, in a form that the driver does not use
    assert parts(outputs.document(1.0))["supply"] == "unknown"
    asked(outputs, "supply", "OUTP?", "1", 2.0)
    assert parts(outputs.document(2.0))["supply"] == "on"
    asked(outputs, "supply", "OUTP?", "what?", 3.0)
    assert parts(outputs.document(3.0))["supply"] == "unknown"


def test_a_chamber_on_hold_is_not_told_as_running_and_its_heat_stays() -> None:
    outputs = all_off()
    asked(outputs, "chamber", "MODE?", str(1 << 4), 1.0)
    asked(outputs, "chamber", "PVAR1?", "55.0", 1.0)
    document = outputs.document(1.0)
    assert (document["state"], document["remains"]) == ("energised", ["mains", "hot"])
    asked(outputs, "chamber", "MODE?", str(1 << 4 | 1 << 3), 2.0)
    document = outputs.document(2.0)
    assert (document["state"], document["remains"]) == ("off", ["mains", "hot"])
    assert [figure["text"] for figure in document["parts"][3]["figures"]] == ["on hold", "55 degC"]
    asked(outputs, "chamber", "PVAR1?", "-20.0", 3.0)
    assert outputs.document(3.0)["remains"] == ["mains", "cold"]


def test_a_table_moves_while_an_interlock_is_closed_or_an_axis_turns() -> None:
    outputs = Outputs({"table": ("acutrol_3000", "GPIB0::9::INSTR")}, GOOD_FOR_S)
    for axis in (1, 2, 3):
        asked(outputs, "table", f":int? {axis}", "Open", 0.0)
        asked(outputs, "table", f":read:rate? {axis}", "0.0", 0.0)
    assert outputs.document(0.0)["state"] == "off"
    asked(outputs, "table", ":int? 2", "Closed", 1.0)
    assert outputs.document(1.0)["state"] == "moving"
    asked(outputs, "table", ":int? 2", "Open", 2.0)
    asked(outputs, "table", ":read:rate? 3", "-12.5", 2.0)  # it coasts
    document = outputs.document(2.0)
    assert document["state"] == "moving"
    assert "rate of axis 3 -12.5 deg/s" in bench_in_words(document)


def test_a_bench_whose_drivers_are_not_here_is_not_known() -> None:
    outputs = Outputs({"thing": ("no_such_driver", "X")}, GOOD_FOR_S)
    asked(outputs, "thing", "OUTP?", "0", 0.0)
    assert outputs.document(0.0)["state"] == "unknown"
