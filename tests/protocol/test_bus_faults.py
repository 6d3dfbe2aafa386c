"""Each fault of a bus on each kind of bus: what the bench makes of it, and that no answer is that to another question.

As a program it prints the rows of docs/instruments.md.
"""

import os
import socket
import threading
import tty
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from sim_bench import ADDRESSES, DRIVERS, Served, serve

from bench.model.clock import WallClock
from bench.model.errors import InstrumentError
from bench.plan.station import boards_of
from bench.run.bus.opener import Visa, open_instrument, open_visa

PAGE = Path(__file__).parents[2] / "docs" / "instruments.md"
BUSES = ("GPIB", "HiSLIP", "raw socket", "Prologix", "RS-232")
ONCE = ("late", "garbled", "lost", "two replies", "power cycle")
LASTING = ("mute", "hang")
REMEDIES = {"<open>": "opened again", "<device clear>": "device clear", "*IDN?": "echo", "VOLT?": "asked again"}


def line_to(port: int) -> str:
    """A serial line at whose other end is what answers at a raw socket."""
    master, slave = os.openpty()
    tty.setraw(slave)
    sock = socket.create_connection(("127.0.0.1", port))

    def carry(take: Callable[[int], bytes], give: Callable[[bytes], Any]) -> None:
        while chunk := take(4096):
            give(chunk)

    for take, give in ((sock.recv, partial(os.write, master)), (partial(os.read, master), sock.sendall)):
        threading.Thread(target=carry, args=(take, give), daemon=True).start()
    return f"ASRL{os.ttyname(slave)}::INSTR"


def opened(served: Served, bus: str, heard: list[str]) -> tuple[Visa, Any]:
    """The supply behind a kind of bus, as the bench opens it; an answer may take 0.3 s here."""
    servers, library = served.servers, "@py" if bus != "GPIB" else served.world.visa_library
    addresses: dict[str, Callable[[], str]] = {
        "GPIB": lambda: ADDRESSES["supply"], "HiSLIP": lambda: servers.resources()["supply"],
        "raw socket": lambda: servers.sockets()["supply"],
        "Prologix": lambda: f"GPIB0::{list(DRIVERS).index('supply') + 1}::INSTR",
        "RS-232": lambda: line_to(int(servers.sockets()["supply"].split("::")[2])),
    }  # fmt: skip
    visa = open_visa(library, boards_of([servers.adapter]) if bus == "Prologix" else {})
    entry: Any = SimpleNamespace(driver="hp_6632b", resource=addresses[bus](), options={}, line={})
    driver: Any = open_instrument(visa, "supply", entry, WallClock(), lambda *line: heard.append(line[2]), used=True)
    driver.timeout_s = 0.3
    return visa, driver


def begin(fault: str, bus: str, served: Served, driver: Any) -> None:
    device, faults = served.world.instruments["supply"], served.world.faults.instrument("supply")
    connections = list(served.servers._adapter._threads)[-1:]
    {
        "late": lambda: vars(faults).update(late_s=0.6, late_replies=1),
        "garbled": lambda: vars(faults).update(garbled_replies=1),
        "mute": lambda: vars(faults).update(mute=True),
        "hang": lambda: vars(faults).update(hang=True),
        "lost": lambda: [each.shutdown(2) for each in connections] if bus == "Prologix" else driver.bus.release(),
        "two replies": lambda: vars(device).update(
            reply=lambda *given, **how: [vars(device).pop("reply"), *[device.reply(*given, **how) for _ in range(2)]]),
        "power cycle": device.power_up,
    }[fault]()  # fmt: skip


def outcome(served: Served, bus: str, fault: str) -> str:
    """How the bench got its answers, or the code of the error; then the bench is safe, and asks again."""
    device, faults, heard = served.world.instruments["supply"], served.world.faults.instrument("supply"), list[str]()
    visa, driver = opened(served, bus, heard)
    driver.configure(12.0, 1.0, 14.0)
    begin(fault, bus, served, driver)
    told: list[str] = []
    try:
        if fault == "power cycle":
            driver.output_on()
        for wanted in (12.0, 3.0, 4.0):
            heard.clear()
            vars(device)["voltage_V"] = wanted
            assert driver.ask("VOLT?", float) == wanted, "an answer to another question"
            told += [word for mark, word in REMEDIES.items() if heard.count(mark) > (mark == "VOLT?")][:1]
    except InstrumentError as error:
        told.append(error.code)
    faults.mute = faults.hang = False
    for _ in range(18):  # on a serial line nothing counts until what was asked is 10 s old
        with suppress(InstrumentError):
            driver.make_safe()
            break
    else:
        pytest.fail("it is never safe")
    assert driver.ask("VOLT?", float) == vars(device)["voltage_V"], "afterwards"
    driver.close()
    visa.close()
    return ", ".join(told) or "nothing"


def rows(faults: Sequence[str]) -> list[str]:
    with serve() as served:
        served.no_latency()
        return [f"| {' | '.join([fault, *(outcome(served, bus, fault) for bus in BUSES)])} |" for fault in faults]


@pytest.mark.waits
@pytest.mark.parametrize("faults", [ONCE, pytest.param(LASTING, marks=pytest.mark.sweep)])
def test_what_comes_of_each_fault_is_what_the_page_says(faults: Sequence[str]) -> None:
    assert set(rows(faults)) <= set(PAGE.read_text(encoding="utf-8").splitlines())


if __name__ == "__main__":
    print("\n".join(rows(ONCE + LASTING)))
