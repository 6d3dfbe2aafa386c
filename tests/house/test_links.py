"""Links between the pages of the documentation lead somewhere, and every page can be reached."""

from __future__ import annotations

import re

from tree import TOP, name_of

LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")
PAGES = [TOP / "README.md", TOP / "CHANGELOG.md", *sorted((TOP / "docs").rglob("*.md"))]


def test_links_lead_somewhere() -> None:
    broken = [
        f"{name_of(page)}: {target}"
        for page in PAGES
        for target in LINK.findall(page.read_text(encoding="utf-8"))
        if not (page.parent / target).exists()
    ]
    assert broken == []


def test_every_page_of_the_docs_is_in_its_index() -> None:
    index = LINK.findall((TOP / "docs" / "README.md").read_text(encoding="utf-8"))
    pages = {page.name for page in (TOP / "docs").glob("*.md")} - {"README.md"}
    assert pages - set(index) == set()
