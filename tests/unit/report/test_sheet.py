"""Tables on paper: inside the width, nothing cut, and in parts where a row cannot be set on one line."""

from __future__ import annotations

import pytest
from fontTools.ttLib import TTFont

from bench.report.fonts import folder, legible, missing, width_pt
from bench.report.sheet import ROOM_pt, SIZES_pt, sheets
from bench.report.tables import Table


def test_widths_and_glyphs_are_those_of_another_reader_of_the_font() -> None:
    for bold, file in ((False, "DejaVuSans.ttf"), (True, "DejaVuSans-Bold.ttf")):
        with TTFont(folder() / file) as font:
            charmap, advances, units = font.getBestCmap(), font["hmtx"], font["head"].unitsPerEm
        for text in ("Scale-factor error / ppm", "−12\u202f345.678 ± 0.012", "µΩ°C²∞√·…–—"):
            expected = 10.0 * sum(advances[charmap[ord(one)]][0] for one in text) / units
            assert width_pt(text, 10.0, bold) == pytest.approx(expected, rel=1e-6)
        assert ord("한") not in charmap


def test_a_character_without_a_glyph_is_written_as_its_code() -> None:
    assert missing("−°µ±∞²³√·…–—\u202f\u2060\u200b\n") == set()
    assert missing("A한") == {"한"}
    assert legible("한 A") == "[U+D55C] A"


def test_a_narrow_table_keeps_its_size_and_its_words() -> None:
    table = Table("c", ("channel", "N / ppm"), (("1", "−240 ± 20"), ("2", "1 ± 20")))
    (one,) = sheets(table, ROOM_pt)
    assert one.size_pt == SIZES_pt[0]
    assert sum(one.widths_pt) < 0.5 * ROOM_pt
    assert one.table.rows[0][1] == "−240\u00a0±\u00a020"  # a value is never broken
    assert width_pt("−240 ± 20", one.size_pt) < one.widths_pt[1]


def test_words_are_broken_over_lines_before_the_type_gets_smaller() -> None:
    table = Table("c", ("item", "in words"), (("a", "word " * 80),), prose=True)
    (one,) = sheets(table, ROOM_pt)
    assert one.size_pt == SIZES_pt[0]
    assert sum(one.widths_pt) == pytest.approx(ROOM_pt)


def test_a_word_longer_than_the_page_can_be_broken() -> None:
    (one,) = sheets(Table("c", ("hash",), (("f" * 400,),)), ROOM_pt)
    assert sum(one.widths_pt) <= ROOM_pt
    assert one.table.rows[0][0].replace("\u200b", "") == "f" * 400


def test_a_table_too_wide_goes_in_parts_that_name_their_rows() -> None:
    headers = ("channel", *(f"quantity{column:02d} / nA" for column in range(30)))
    rows = tuple((str(row), *(f"{row}{column:02d}.5 ± 0.1" for column in range(30))) for row in range(3))
    parts = sheets(Table("c", headers, rows), ROOM_pt)
    assert len(parts) > 1
    assert all(sum(one.widths_pt) <= ROOM_pt and one.size_pt == SIZES_pt[-1] for one in parts)
    assert all(one.table.headers[0] == "channel" for one in parts)
    shown = [cell.replace("\u00a0", " ") for one in parts for cell in one.table.rows[2][1:]]
    assert shown == list(rows[2][1:])


def test_a_table_to_fill_in_takes_the_whole_width() -> None:
    table = Table("c", ("", "name", "signature"), (("prepared", "", ""),), to_fill=True)
    (one,) = sheets(table, ROOM_pt)
    assert sum(one.widths_pt) == pytest.approx(ROOM_pt)
    assert one.widths_pt[1] == one.widths_pt[2] > 100.0
