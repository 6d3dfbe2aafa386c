"""The blocks of code in the pages: cut out by a Markdown parser, sorted by what they are."""

import functools
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMANDS = ("bench", ".venv/bin/bench", "make", "pip", "pytest", "dask", "ssh", "rm", "OMP_NUM_THREADS=1")
_YAML = re.compile(r"(- )?[a-z_]+:\s")


@dataclass(frozen=True)
class Block:
    """A block of a page: ``words`` behind its fence (``sh``, ``yaml file=x.yaml``), none of an indented one."""

    page: str
    line: int
    words: tuple[str, ...]
    text: str

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def file(self) -> str:
        """Return the file that the reader is told to write, "" if it is none."""
        return next((word.removeprefix("file=") for word in self.words if word.startswith("file=")), "")

    @property
    def language(self) -> str:
        """Return what it is: as its fence says, else as it begins; "text" is not code."""
        if self.words:
            return self.words[0]
        first = self.text.lstrip().removeprefix("$ ")
        if first.split()[0] in COMMANDS:
            return "sh"
        return "yaml" if _YAML.match(first) else "text"

    @property
    def command_lines(self) -> list[str]:
        """Return the commands of a block of a shell; where some begin with "$ ", the rest is what they print."""
        lines = [line.strip() for line in self.text.replace("\\\n", " ").splitlines() if line.strip()]
        prompted = [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]
        return prompted or lines


def words_of(line: str) -> list[str]:
    """Return the words of a command line, without its comment and without what the shell does with its output."""
    return shlex.split(line.partition(" > ")[0], comments=True)


def blocks_of(page: Path) -> Iterator[Block]:
    """Yield the blocks of a page, fenced and indented, also inside of lists."""
    for token in MarkdownIt("commonmark").parse(page.read_text(encoding="utf-8")):
        if token.type in ("fence", "code_block") and token.map:
            name = page.relative_to(ROOT).as_posix()
            yield Block(name, token.map[0] + 1, tuple(token.info.split()), token.content)


@functools.cache  # parsed once by each worker, not once for each language
def all_blocks() -> tuple[Block, ...]:
    """Return the blocks of all pages."""
    return tuple(block for page in PAGES for block in blocks_of(page))


def blocks(language: str) -> list[Block]:
    """Return all blocks of a language, of all pages."""
    return [block for block in all_blocks() if block.language == language]
