"""Memories of the simulated module: FLASH as FLASH is, faults where they sit, results that follow."""

import numpy as np
import pytest

from sim_instruments.worlds.gnc.processor import SECTOR, SIZE, Memories, ModuleDraws, Operation, Region, pattern_of

WORDS = SECTOR // 4


def memories(*faults, seed=1, serial="GNC-01"):
    return Memories(ModuleDraws(seed, serial), set(faults))


def prepared(memory, region, pattern=2, length=SECTOR):
    memory.do(region, Operation.ERASE, 0, 0, length)
    memory.do(region, Operation.PROGRAM, pattern, 0, length)
    return memory.do(region, Operation.VERIFY, pattern, 0, length)


def test_patterns():
    words = np.array([0, 1, 1024])
    assert [hex(v) for v in pattern_of(0, words)] == ["0x55555555"] * 3
    assert [hex(v) for v in pattern_of(1, words)] == ["0xaaaaaaaa"] * 3
    assert list(pattern_of(2, words)) == [0, 4, 4096]


@pytest.mark.parametrize("region", [Region.SPI_FLASH, Region.INTERNAL_FLASH])
def test_flash_is_not_blank_until_it_is_erased_and_holds_what_is_programmed(region):
    memory = memories()
    assert memory.do(region, Operation.BLANK_CHECK, 0, 0, SECTOR).wrong > 0.99 * WORDS
    memory.do(region, Operation.ERASE, 0, 0, SECTOR)
    assert memory.do(region, Operation.BLANK_CHECK, 0, 0, SECTOR).wrong == 0
    assert memory.do(region, Operation.BLANK_CHECK, 0, SECTOR, 4).wrong == 1, "only what was erased is blank"
    assert prepared(memory, region).wrong == 0
    assert memory.erases[region] == 2


def test_programming_turns_ones_into_zeros_only():
    memory = memories()
    prepared(memory, Region.SPI_FLASH, pattern=0)
    memory.do(Region.SPI_FLASH, Operation.PROGRAM, 1, 0, SECTOR)
    found = memory.do(Region.SPI_FLASH, Operation.VERIFY, 1, 0, SECTOR)
    assert (found.wrong, found.expected, found.received) == (WORDS, 0xAAAAAAAA, 0)


def test_erasing_takes_whole_sectors():
    memory = memories()
    memory.do(Region.SPI_FLASH, Operation.ERASE, 0, SECTOR - 4, 8)
    assert memory.do(Region.SPI_FLASH, Operation.BLANK_CHECK, 0, 0, 2 * SECTOR).wrong == 0
    assert memory.do(Region.SPI_FLASH, Operation.BLANK_CHECK, 0, 2 * SECTOR, 4).wrong == 1


def test_the_end_of_a_memory_can_be_reached():
    memory = memories()
    for region, operation in ((Region.RAM, Operation.WRITE_READ), (Region.SPI_FLASH, Operation.ERASE)):
        assert memory.do(region, operation, 2, SIZE[region] - 4, 4).checked == 1


def test_a_stuck_bit_is_wrong_where_the_pattern_has_a_zero():
    memory = memories("ram_stuck_bit")
    found = [memory.do(Region.RAM, Operation.WRITE_READ, pattern, 0, SIZE[Region.RAM]) for pattern in (0, 1, 2)]
    assert [one.wrong for one in found] == [0, 1, 1]
    assert found[1].received == found[1].expected | 1 << 30
    assert found[1].address == found[2].address < SECTOR


def test_coupled_cells_are_found_by_addresses_only():
    memory = memories("ram_coupled_bits")
    found = [memory.do(Region.RAM, Operation.WRITE_READ, pattern, 0, SECTOR).wrong for pattern in (0, 1, 2)]
    assert found[:2] == [0, 0]
    assert found[2] in (1, 2)


@pytest.mark.parametrize("length", [SECTOR, SIZE[Region.SDRAM]])
def test_shorted_address_lines_are_found_by_addresses_only(length):
    memory = memories("sdram_address_short")
    found = [memory.do(Region.SDRAM, Operation.WRITE_READ, pattern, 0, length) for pattern in (0, 1, 2)]
    assert [one.wrong for one in found[:2]] == [0, 0]
    assert found[2].wrong >= length // 8
    assert found[2].expected ^ found[2].received in (1 << 9, 1 << 13, 1 << 9 | 1 << 13)


def test_an_open_data_line_reads_one():
    found = memories("sdram_data_open").do(Region.SDRAM, Operation.WRITE_READ, 1, 0, SECTOR)
    assert (found.wrong, found.received) == (WORDS, 0xAAAAAAAA | 1 << 22)


def test_a_weak_cell_is_not_blank_and_lost_bits_are_not_verified():
    weak, lost = memories("flash_weak_cell"), memories("flash_lost_bits")
    for memory, blank_wrong, verify_wrong in ((weak, 1, 0), (lost, 0, 1)):
        memory.do(Region.SPI_FLASH, Operation.ERASE, 0, 0, SECTOR)
        assert memory.do(Region.SPI_FLASH, Operation.BLANK_CHECK, 0, 0, SECTOR).wrong == blank_wrong
        memory.do(Region.SPI_FLASH, Operation.PROGRAM, 2, 0, SECTOR)
        assert memory.do(Region.SPI_FLASH, Operation.VERIFY, 2, 0, SECTOR).wrong == verify_wrong


def test_what_lies_elsewhere_is_not_touched_by_a_fault():
    memory = memories("flash_weak_cell", "internal_flash_worn", "flash_lost_bits")
    for region in (Region.SPI_FLASH, Region.INTERNAL_FLASH):
        memory.do(region, Operation.ERASE, 0, SECTOR, SECTOR)
        memory.do(region, Operation.PROGRAM, 2, SECTOR, SECTOR)
        assert memory.do(region, Operation.VERIFY, 2, SECTOR, SECTOR).wrong == 0


def test_places_follow_from_seed_and_serial():
    places = {
        memories("ram_stuck_bit", seed=seed, serial=serial).do(Region.RAM, Operation.WRITE_READ, 1, 0, SECTOR).address
        for seed in (1, 2, 3)
        for serial in ("A", "B")
    }
    assert len(places) >= 5
    again = memories("ram_stuck_bit", seed=3, serial="B").do(Region.RAM, Operation.WRITE_READ, 1, 0, SECTOR).address
    assert again in places
