"""Print today's figures of weight beside the last row of ``benchmarks/record.md``: ``make figures``.

``--row`` prints them as the next row of that table.
"""

import ast
import io
import json
import re
import subprocess
import sys
import tokenize
from functools import cache
from pathlib import Path

from tree import PRODUCT, TOP, docstrings, python_files, text_of

RECORD = TOP / "benchmarks" / "record.md"
HEADING = "## Weight"
_DEEP = re.compile(rf"^ *from ((?:{'|'.join(PRODUCT)})(?:\.\w+){{3,}}) import ", re.MULTILINE)
SKIP = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING,
    tokenize.ENDMARKER,
}  # fmt: skip


def tokens_and_lines(text: str) -> tuple[int, int]:
    """Return tokens without comments, layout and docstrings, and the lines in which one of them begins."""
    places = {(node.lineno, node.col_offset) for node in docstrings(ast.parse(text)) if isinstance(node.value, str)}
    starts = [
        token.start
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type not in SKIP and token.start not in places
    ]
    return len(starts), len({line for line, _ in starts})


def product_files() -> list[Path]:
    """Return the files that are counted."""
    return [path for path in python_files(*PRODUCT) if path.parent != TOP]


def deep_modules(text: str) -> set[str]:
    """Return the modules of the product three or more levels deep that a file imports."""
    return set(_DEEP.findall(text))


def counted() -> dict[str, float]:
    """Return what is counted in texts."""
    texts = [text_of(path) for path in product_files()]
    tokens, lines = (sum(numbers) for numbers in zip(*map(tokens_and_lines, texts), strict=True))
    pages = [TOP / "README.md", TOP / "CHANGELOG.md", *(TOP / "docs").rglob("*.md")]
    return {
        "tokens": tokens,
        "tokens a line": round(tokens / lines, 2),
        "files": len(texts),
        "dict[str, Any]": sum(text.count("dict[str, Any]") for text in texts),
        "lines of tests": sum(text_of(path).count("\n") for path in python_files("tests")),
        "tests of several deep modules": sum(len(deep_modules(text_of(path))) > 1 for path in python_files("tests")),
        "words of docs": sum(len(page.read_text(encoding="utf-8").split()) for page in pages if page.is_file()),
    }


@cache
def walked() -> dict[str, float]:
    """Return the figures of the ways, from a process of its own. Raises: CalledProcessError if the rehearsal fails."""
    command = [sys.executable, str(Path(__file__).with_name("ways.py")), "--json"]
    return json.loads(subprocess.run(command, cwd=TOP, check=True, stdout=subprocess.PIPE).stdout)


def last_row() -> dict[str, str]:
    """Return the last row of the table of weights by the names of its columns."""
    rows = re.findall(r"^\| (.*) \|$", text_of(RECORD).partition(HEADING)[2].partition("\n## ")[0], re.MULTILINE)
    return dict(zip(rows[0].split(" | "), rows[-1].split(" | "), strict=True))


def main(words: list[str]) -> None:
    """Print the figures."""
    figures = counted() | walked()
    texts = {name: f"{figure:,}" if figure >= 1000 else f"{figure:g}" for name, figure in figures.items()}
    before = last_row()
    if words == ["--row"]:
        sys.stdout.write(f"| {' | '.join(['WHEN', *(texts[name] for name in list(before)[1:])])} |\n")
        return
    sys.stdout.write(f"{'':32} {'today':>10} {'recorded':>10}  ({before['when']})\n")
    for name, text in texts.items():
        sys.stdout.write(f"{name:32} {text:>10} {before.get(name, '-'):>10}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
