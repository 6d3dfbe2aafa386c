"""``bench explain``: what an error code means and what to do, or a page of the documentation."""

from __future__ import annotations

import difflib
from pathlib import Path

from rich.markdown import Markdown

from bench.commands.console import console, say
from bench.model.errors import InputError, words_in
from bench.model.lab import shipped_folder


def error_codes() -> dict[str, dict[str, str]]:
    """Return ``exit``, ``what`` happened and what to do ``next`` of every code."""
    codes: dict[str, dict[str, str]] = words_in("errors.json")
    return codes


def pages() -> dict[str, Path]:
    """Return the pages of the documentation by their names."""
    return {path.stem: path for path in sorted(shipped_folder("docs").rglob("*.md"))}


def explain(topic: str) -> None:
    """Print what is known of a code, or a page as text. Raises: InputError B-CLI-011 for what is neither."""
    codes, known = error_codes(), pages()
    code, page = topic.upper(), Path(topic).stem
    if code in codes:
        row = codes[code]
        say(f"{code}, exit status {row['exit']}\n{row['what']}\nNext: {row['next']}")
    elif page in known:
        out = console()
        with out.pager():
            out.print(Markdown(known[page].read_text(encoding="utf-8")))
    else:
        near = difflib.get_close_matches(code, codes, n=3) or difflib.get_close_matches(page, known, n=3)
        names = [name for name in known if name[0].isalpha()]  # decisions begin with their numbers
        meant = f"did you mean {' or '.join(near)}?" if near else f"name an error code or a page: {', '.join(names)}"
        raise InputError("B-CLI-011", f"there is no error code and no page {topic!r}", next_step=meant)
