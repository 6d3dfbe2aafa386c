"""Build the site of documentation: ``make site``.

The pages are those of docs/ as they are, in the order and the four parts of docs/README.md. What is written from the
software itself (commands, YAML keys, Python interface) is made anew here and never kept. Sphinx reads a copy of all
that below build/site/source; links of the pages lead to files of the repository, which are copied with them.
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

from api import api_page
from commands import commands_page
from errors import errors_page
from manuals import manual_pages
from schemas import TITLES, schema_pages

TOP = Path(__file__).resolve().parents[2]
LINK = re.compile(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)")
FOLDERS = {"instruments": "Commands of each driver", "decisions": "Decisions"}
GENERATED = [
    "reference/commands",
    "reference/errors",
    *(f"reference/{kind}" for kind in TITLES),
    "reference/api",
    "instruments/index",
]


def parts() -> dict[str, list[str]]:
    """Return the pages below docs/ by the headings of docs/README.md, in their order, without suffix."""
    found: dict[str, list[str]] = {}
    for section in (TOP / "docs" / "README.md").read_text(encoding="utf-8").split("\n## ")[1:]:
        heading, _, text = section.partition("\n")
        names = [re.sub(r"\.(md|ipynb)$", "", re.sub("/$", "/index", target)) for target in LINK.findall(text)]
        found[heading] = list(dict.fromkeys(names))
    found["Reference"] = [*GENERATED, *found["Reference"]]
    return found


def generated_pages() -> dict[str, str]:
    """Return what is written from the software itself, by its place below docs/."""
    pages = {"reference/commands.md": commands_page(), "reference/api.md": api_page()}
    pages["reference/errors.md"] = errors_page()
    pages |= {f"reference/{kind}.md": page for kind, page in schema_pages().items()}
    pages |= manual_pages()
    for folder, title in FOLDERS.items():
        pages[f"{folder}/index.md"] = f"# {title}\n\n```{{toctree}}\n:maxdepth: 1\n:glob:\n*\n```\n"
    return pages


def front_page() -> str:
    """Return README.md with the navigation behind it."""
    text = (TOP / "README.md").read_text(encoding="utf-8")
    for heading, names in parts().items():
        entries = "\n".join(f"docs/{name}" for name in names)
        text += f"\n```{{toctree}}\n:hidden:\n:caption: {heading}\n:titlesonly:\n\n{entries}\n```\n"
    return text + "\n```{toctree}\n:hidden:\n:caption: About\n\ndocs/README\nCHANGELOG\n```\n"


def gather(source: Path) -> None:
    """Write everything that the site is made of below ``source``."""
    shutil.copytree(TOP / "docs", source / "docs", ignore=shutil.ignore_patterns("site"))
    for name in ("README.md", "CHANGELOG.md"):
        shutil.copy(TOP / name, source / name)
    _copy_linked(source)
    (source / "README.md").unlink()
    (source / "index.md").write_text(front_page(), encoding="utf-8")
    for name, page in generated_pages().items():
        (source / "docs" / name).parent.mkdir(exist_ok=True)
        (source / "docs" / name).write_text(page, encoding="utf-8")
    index = source / "docs" / "README.md"
    index.write_text(index.read_text(encoding="utf-8").replace("(decisions/)", "(decisions/index.md)"), "utf-8")


def _copy_linked(source: Path) -> None:
    """Copy the files outside of docs/ that a page leads to; a page among them stands in no menu."""
    due = sorted(source.rglob("*.md"))
    while due:
        page = due.pop()
        for target in LINK.findall(page.read_text(encoding="utf-8")):
            path = (page.parent / target).resolve()
            original = TOP / path.relative_to(source.resolve())
            if path.exists() or not original.is_file():
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(original, path)
            if path.suffix == ".md":
                path.write_text(f"---\norphan: true\n---\n{path.read_text(encoding='utf-8')}", encoding="utf-8")
                due.append(path)


def main() -> int:
    """Gather and build; return Sphinx's exit status, not 0 after any warning."""
    from sphinx.cmd.build import main as sphinx

    place = TOP / "build" / "site"
    shutil.rmtree(place, ignore_errors=True)
    gather(place / "source")
    options = ["--fail-on-warning", "--keep-going", "--quiet", "--builder", "html", "--conf-dir"]
    return sphinx([*options, str(Path(__file__).parent), str(place / "source"), str(place / "html")])


if __name__ == "__main__":
    sys.exit(main())
