"""Frames that are found one by one: between delimiters, in lines of text, without sync bytes."""

from bench.frame.packets.escape import ESCAPES
from bench.frame.packets.lines import LineReader, one_by_one, why_bad
