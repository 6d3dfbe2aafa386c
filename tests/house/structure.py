"""Say how the product is built: files, imports, circles, the largest folders, lines and statements.

Run by ``make structure``, for another tree by ``python tests/house/structure.py FOLDER``.
"""

import ast
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from tree import PRODUCT, TOP, imported

Arrows = Mapping[str, set[str]]


def arrows(trees: Mapping[str, ast.Module]) -> Arrows:
    """Return the modules among ``trees`` that each of them imports; a name of a module counts as the module."""
    pointed = {}
    for name, tree in trees.items():
        full = {target if target in trees else target.rpartition(".")[0] for target in imported(tree)}
        pointed[name] = (full & trees.keys()) - {name}
    return pointed


def circles(pointed: Arrows) -> list[set[str]]:
    """Return the groups of modules each of which is reached from every other one."""
    reached = {name: _reached(name, pointed) for name in pointed}
    groups: list[set[str]] = []
    for name, others in reached.items():
        group = {other for other in others if name in reached[other]}
        if name in group and group not in groups:
            groups.append(group)
    return groups


def _reached(start: str, pointed: Arrows) -> set[str]:
    reached: set[str] = set()
    ahead = list(pointed[start])
    while ahead:
        name = ahead.pop()
        if name not in reached:
            reached.add(name)
            ahead += pointed[name]
    return reached


def main(top: Path) -> None:
    """Print the structure of the tree in a folder."""
    files = [path for folder in PRODUCT for path in (top / folder).rglob("*.py")]
    names = {".".join(path.relative_to(top).with_suffix("").parts).removesuffix(".__init__"): path for path in files}
    texts = {name: path.read_text(encoding="utf-8") for name, path in names.items()}
    trees = {name: ast.parse(text) for name, text in texts.items()}
    pointed = arrows(trees)
    folders = Counter(path.parent.relative_to(top).as_posix() for path in files)
    statements = sum(isinstance(node, ast.stmt) for tree in trees.values() for node in ast.walk(tree))
    lines = sum(text.count("\n") for text in texts.values())
    said = [
        f"{len(files)} files, {lines} lines, {statements} statements",
        f"{sum(map(len, pointed.values()))} imports between them, {len(circles(pointed))} circles",
        "largest folders: " + ", ".join(f"{name} {count}" for name, count in folders.most_common(5)),
    ]
    sys.stdout.write("\n".join(said) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else TOP)
