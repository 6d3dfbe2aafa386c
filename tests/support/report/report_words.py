"""What a reader of a report must not meet: the names of the code."""

from __future__ import annotations

import re

_CODE_NAME = re.compile(r"(?<![\w/.])[a-z][a-z0-9]*(?:_[a-z0-9]+)+(?![\w/.])")


def code_names(page: str) -> set[str]:
    """Return words with underscores that a reader sees, but for what names files: the sequence, software and hashes."""
    seen = re.sub(r"<(style|section id=\"provenance\").*?</(style|section)>", "", page, flags=re.DOTALL)
    return set(_CODE_NAME.findall(re.sub(r"<[^>]*>|Sequence \w+,", " ", seen)))
