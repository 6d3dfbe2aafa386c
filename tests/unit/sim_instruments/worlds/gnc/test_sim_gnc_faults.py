"""Each fault of the simulated module fails exactly the unit tests that its table names; a sound module fails none."""

import re
from pathlib import Path

import pytest
from gnc_judge import ITEMS, failed_items
from gnc_rig import SUPPLY, open_host

from bench.model.errors import InputError
from sim_instruments.worlds.gnc.faults import FAULTS, parse_faults
from sim_instruments.worlds.simulation import open_world

TABLE = Path(__file__).resolve().parents[5] / "docs" / "gnc-faults.md"
ROW = re.compile(r"^\| (\d+) \| `(\w+)` \| (.+) \| ([\w, ]+) \|$", re.MULTILINE)


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_fails_exactly_its_tests(name):
    with open_host(3, "GNC-02", on=False, options={"faults": f"GNC-01=sci_silent,GNC-02={name}"}) as host:
        assert failed_items(host)[0] == set(FAULTS[name].fails)


def test_the_table_of_the_documentation_is_the_one_of_the_code():
    told = {name: (int(code), wrong, fails) for code, name, wrong, fails in ROW.findall(TABLE.read_text())}
    meant = {
        name: (fault.code, fault.wrong, "all" if fault.fails == ITEMS else ", ".join(fault.fails))
        for name, fault in FAULTS.items()
    }
    assert told == meant
    assert len(told) >= 25
    assert len({fault.code for fault in FAULTS.values()}) == len(FAULTS)


def test_two_faults_at_once_fail_the_tests_of_both():
    with open_host(3, "A", on=False, options={"faults": "A=gps_silent+io_open"}) as host:
        assert failed_items(host)[0] == {"gps", "io", "spi"}


@pytest.mark.parametrize("name", ["cpu_carry", "gps_silent", "spi_lost_clock"])
def test_a_fault_can_be_switched_on_by_a_command(name):
    with open_host(3) as host:
        assert host.ask(0x7E, "B", FAULTS[name].code) == (0, b"")
        assert failed_items(host)[0] == set(FAULTS[name].fails)


def sound_modules_pass(seeds):
    for seed in seeds:
        serial = f"GNC-{seed:03}"
        with open_host(seed, serial, on=False) as host:
            failed, duration_s = failed_items(host)
        assert not failed, (seed, failed)
        assert 8.0 <= duration_s <= 9.0, (seed, duration_s)  # the rest up to 10 s is left to boot and controller


def test_a_module_without_faults_passes_and_takes_its_time():
    sound_modules_pass(range(8))


@pytest.mark.sweep
def test_two_hundred_modules_without_faults_pass():
    sound_modules_pass(range(200))


def test_a_module_passes_again_and_again():
    with open_host(9, on=False) as host:
        assert failed_items(host)[0] == set()
        host.instrument(SUPPLY).write("OUTP OFF")
        host.board.module.memories.erases.update(dict.fromkeys(host.board.module.memories.erases, 0))
        assert failed_items(host)[0] == set()


@pytest.mark.parametrize("text", ["GNC-01", "GNC-01=", "=cpu_carry", "GNC-01=cpu_cary", "GNC-01=cpu_carry+"])
def test_an_option_that_cannot_be_read_is_refused(text):
    with pytest.raises(InputError, match="B-SIM-002"):
        parse_faults(text)
    with pytest.raises(InputError, match="B-SIM-002"):
        open_world("gnc_module", clock=None, seed=1, station={}, options={"faults": text})


@pytest.mark.parametrize("text", ["", "none"])
def test_no_faults(text):
    assert parse_faults(text) == {}


def test_the_nearest_fault_is_named():
    with pytest.raises(InputError) as caught:
        parse_faults("GNC-01=flash_week_cell")
    assert "'flash_weak_cell'" in str(caught.value.next_step)
