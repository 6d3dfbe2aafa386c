"""The page of all error codes, from bench/model/errors.json, which `bench explain` prints."""

from __future__ import annotations

import re

from bench.commands.lookup import error_codes

HEAD = """# Errors

Every error the bench reports on purpose has a code that never changes its meaning. It says where it happened, the
value, the limit, and what to do next; `bench explain CODE` prints its row of this table.
[Exit statuses](../user-guide.md#4-run) have a table of their own.

| code | exit | what happened | what to do |
|---|---|---|---|
"""
_PAGE = re.compile(r"docs/([a-z-]+)\.md")


def errors_page() -> str:
    """Return the page as Markdown; a page that a row names is a link."""
    rows = (f"| {code} | {row['exit']} | {row['what']} | {row['next']} |\n" for code, row in error_codes().items())
    return HEAD + _PAGE.sub(r"[\1](../\1.md)", "".join(rows))
