"""The one YAML loader: strict, bounded, and every mistake comes with file:line:column, all at once.

What is refused: duplicate keys, aliases and anchors, tags, several documents, control characters, files over 1 MB,
nesting over 50, more than 50,000 values, keys that are not text, integers over 64 bits. Plain scalars follow the
YAML 1.2 core rules: ``1e5`` is a number, ``on`` and ``1:30`` are text, only ``true`` and ``false`` are booleans;
``.inf`` and ``.nan`` are text. Values are then checked by a pydantic model (types, units, limits, unknown keys).
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Generic, NoReturn, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, StringConstraints, ValidationError

from bench.model.errors import InputError, InputErrors, listed, words_in

MAX_BYTES = 1_000_000
MAX_DEPTH = 50
MAX_VALUES = 50_000
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_NOT_TEXT = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]")
_INT = re.compile(r"[-+]?(0|[1-9][0-9]*)")
_HEX = re.compile(r"0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|(0|[1-9][0-9]*)(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_CONSTANTS = {"": None, "~": None, "null": None, "true": True, "false": False}
_MAX_DIGITS = 300
# Words for what a validator or a parser refuses, what is due and what to do: by the kind of mistake, of a text by its
# pattern, of the parser by a part of its own words; where one value is due, what to do by the type that was found.
SLIPS = "slips.json"
_NOT_DUE, _FOUND = "B-YAML-013", " is due (found "

Path_ = tuple[str | int, ...]
ModelT = TypeVar("ModelT", bound=BaseModel)


NAME_PATTERN = r"[a-z][a-z0-9_]{0,39}"


def characters(most: int) -> StringConstraints:
    """Pydantic annotation: a text that is not empty, of ``most`` characters at most."""
    return StringConstraints(min_length=1, max_length=most)


Name = Annotated[str, StringConstraints(pattern=f"^{NAME_PATTERN}$")]


class StrictModel(BaseModel):
    """Base of all YAML schemas: unknown keys are errors, instances are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True, defer_build=True)


@dataclass(frozen=True, order=True)
class Mark:
    """Position in a YAML file, both 1-based."""

    line: int
    column: int

    def of(self, name: str) -> str:
        """Return ``file:line:column`` in a file of this name."""
        return f"{name}:{self.line}:{self.column}"


@dataclass(frozen=True)
class Document(Generic[ModelT]):
    """A checked YAML file: the model, the text it came from and the position of every value."""

    model: ModelT
    text: str
    name: str
    marks: dict[Path_, Mark] = field(repr=False)
    _places: dict[Path_, str] = field(default_factory=dict, repr=False, compare=False)

    def where(self, path: Path_ = ()) -> str:
        """Return ``file:line:column`` of the value at ``path``, or of its nearest parent that stands in the file."""
        if path not in self._places:  # a loop asks for the same place at every turn
            self._places[path] = _mark_at(self.marks, path).of(self.name)
        return self._places[path]


def load_yaml(path: Path, schema: type[ModelT] | Callable[[Any], type[ModelT]]) -> Document[ModelT]:
    """Read and check one YAML file. Raises InputErrors with every mistake found, sorted by position.

    ``schema``: or a function that tells it by the values of the file.
    """
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("B-YAML-001", f"cannot be read: {reason}", where=str(path)) from error
    return parse_yaml(raw, str(path), schema)


def parse_yaml(raw: bytes | str, name: str, schema: type[ModelT] | Callable[[Any], type[ModelT]]) -> Document[ModelT]:
    """Check YAML text against ``schema``, as in ``load_yaml``; ``name`` is the file name used in messages."""
    text = _text(raw.encode() if isinstance(raw, str) else raw, name)
    builder = _Builder(name)
    tree = builder.build(text)
    problems = builder.problems
    form: type[ModelT] = schema if isinstance(schema, type) else schema(tree)
    try:
        model = form.model_validate(tree)
    except ValidationError as error:
        raise _all(problems + _schema_problems(error, builder.marks, form), name) from error
    if problems:
        raise _all(problems, name)
    return Document(model, text, name, builder.marks)


def _text(raw: bytes, name: str) -> str:
    if len(raw) > MAX_BYTES:
        raise InputError("B-YAML-002", f"is larger than {MAX_BYTES} bytes", where=name)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        mark = Mark(raw.count(b"\n", 0, error.start) + 1, error.start - raw.rfind(b"\n", 0, error.start))
        raise InputError("B-YAML-003", "is not UTF-8 text", where=mark.of(name)) from error
    wrong = _NOT_TEXT.search(text)
    if wrong is not None:
        at = wrong.start()
        mark = Mark(text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at))
        raise InputError("B-YAML-016", f"holds the control character U+{ord(wrong[0]):04X}", where=mark.of(name))
    return text


def _place(marks: dict[Path_, Mark], path: Path_) -> Path_:
    """Return ``path`` without parts that are not in the file: names of alternatives, missing keys."""
    place: Path_ = ()
    for part in path:
        place = next((k for k in ((*place, part), (*place, str(part))) if k in marks), place)
    return place


def _mark_at(marks: dict[Path_, Mark], path: Path_) -> Mark:
    return marks.get(_place(marks, path), Mark(1, 1))


@dataclass(frozen=True, order=True)
class _Problem:
    mark: Mark
    code: str
    message: str
    next_step: str = ""

    def error(self, name: str) -> InputError:
        return InputError(self.code, self.message, where=self.mark.of(name), next_step=self.next_step)


def _all(problems: list[_Problem], name: str) -> InputErrors:
    """Return every problem of a file once, in order of position, as many as are listed."""
    return InputErrors(listed([problem.error(name) for problem in sorted(set(problems))]))


def _schema_problems(error: ValidationError, marks: dict[Path_, Mark], schema: type[BaseModel]) -> list[_Problem]:
    problems: list[_Problem] = []
    for item in error.errors(include_url=False):
        kind, place = item["type"], _place(marks, item["loc"])
        if kind == "too_short" and len(item["input"]) >= item["ctx"]["min_length"]:
            continue  # of a list whose parts are wrong: each of them is told
        named = item["loc"] if kind == "missing" else place
        key = next((part for part in reversed(named) if isinstance(part, str) and not part.startswith("<")), "")
        code, message, advice = _explain(item, key, keys_of(schema))
        problem = _Problem(_mark_at(marks, place), code, message, advice)
        if code == _NOT_DUE and problems and (problems[-1].mark, problems[-1].code) == (problem.mark, code):
            before = problems.pop().message.rpartition(_FOUND)[0]  # alternatives, of which none fits
            problem = replace(problem, message=f"{before} or {message.removeprefix(f'{key}: ')}")
        problems.append(problem)
    return problems


@cache
def keys_of(schema: type[BaseModel]) -> tuple[str, ...]:
    """Return all keys that a schema and the schemas in it know."""
    keys: dict[str, None] = {}
    seen: set[Any] = set()
    waiting: list[Any] = [schema]
    while waiting:
        kind = waiting.pop()
        if isinstance(kind, type) and issubclass(kind, BaseModel) and kind not in seen:
            seen.add(kind)
            for name, known in kind.model_fields.items():
                keys[known.alias or name] = None
                waiting.append(known.annotation)
        waiting += get_args(kind)
    return tuple(keys)


def _explain(item: Any, key: str, known: tuple[str, ...]) -> tuple[str, str, str]:
    """Return code, message and next step of what a validator refused at a key. Args: known: keys of the language."""
    kind, value, context = item["type"], item["input"], item.get("ctx", {})
    if kind == "extra_forbidden":
        close = difflib.get_close_matches(key, known, 1)
        advice = "it is a key of another part" if key in known else f"did you mean {close[0]!r}?" if close else ""
        return "B-YAML-010", f"unknown key {key!r}", advice
    if kind == "missing" and isinstance(item["loc"][-1], str):
        return "B-YAML-011", f"the key {key!r} is missing", ""
    label = f"{key}: " if key else ""
    if kind in ("value_error", "step"):
        return "B-YAML-012", label + item["msg"].removeprefix("Value error, "), ""
    pattern, slips = context.get("pattern", kind), words_in(SLIPS)
    due, advice = slips.get(pattern, ("another value", ""))
    if kind in slips["one value"]:
        advice = slips.get(f"found {type(value).__name__}", advice)
    return _NOT_DUE, f"{label}{due.format_map(context)}{_FOUND}{_shorten(context.get('tag', value))})", advice


def first_wrong(error: ValidationError) -> tuple[str, str]:
    """Return where the first mistake of a document is, its keys with points, and what it is in words of the bench."""
    item = error.errors(include_url=False)[0]
    return ".".join(map(str, item["loc"])), _explain(item, "", ())[1]


def _shorten(value: object) -> str:
    if isinstance(value, (dict, list)):
        return "a mapping" if isinstance(value, dict) else "a list"
    text = "nothing" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


@dataclass
class _Level:
    path: Path_
    container: dict[str, Any] | list[Any]
    key: str | None = None


class _Builder:
    """Builds plain Python values from YAML events, with positions; iterative, so depth cannot exhaust the stack."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.marks: dict[Path_, Mark] = {}
        self.problems: list[_Problem] = []
        self.values = 0

    def build(self, text: str) -> Any:
        root: list[Any] = []
        stack: list[_Level] = []
        try:
            for event in yaml.parse(text, Loader=_LOADER):
                self._take(event, stack, root)
        except yaml.YAMLError as error:
            self.problems.append(_not_yaml(error, text))
            raise _all(self.problems, self.name) from error
        return root[0] if root else None

    def _note(self, code: str, message: str, event: Any) -> None:
        self.problems.append(_Problem(_mark_of(event), code, message))

    def _refuse(self, code: str, message: str, event: Any) -> NoReturn:
        self._note(code, message, event)
        raise _all(self.problems, self.name)

    def _take(self, event: Any, stack: list[_Level], root: list[Any]) -> None:
        if isinstance(event, yaml.AliasEvent):
            self._refuse("B-YAML-005", "aliases are not allowed", event)
        if isinstance(event, yaml.DocumentStartEvent) and root:
            self._refuse("B-YAML-006", "a second document is not allowed", event)
        if isinstance(event, (yaml.ScalarEvent, yaml.SequenceStartEvent, yaml.MappingStartEvent)):
            self._node(event, stack, root)
        elif isinstance(event, (yaml.SequenceEndEvent, yaml.MappingEndEvent)):
            stack.pop()

    def _node(self, event: Any, stack: list[_Level], root: list[Any]) -> None:
        self._admit(event)
        level = stack[-1] if stack else None
        if level is not None and isinstance(level.container, dict) and level.key is None:
            self._key(event, level)
            return
        value = self._value(event)
        path = self._attach(level, value, root)
        if level is None or isinstance(level.container, list):
            self.marks[path] = _mark_of(event)
        if not isinstance(event, yaml.ScalarEvent):
            if len(stack) >= MAX_DEPTH:
                self._refuse("B-YAML-008", f"nesting over {MAX_DEPTH} levels", event)
            stack.append(_Level(path, value))

    def _admit(self, event: Any) -> None:
        if event.anchor is not None:
            self._refuse("B-YAML-005", "anchors are not allowed", event)
        if event.tag is not None and event.tag != "!":
            self._refuse("B-YAML-007", f"the tag {event.tag!r} is not allowed", event)
        self.values += 1
        if self.values > MAX_VALUES:
            self._refuse("B-YAML-015", f"holds more than {MAX_VALUES} values", event)

    def _key(self, event: Any, level: _Level) -> None:
        if not isinstance(event, yaml.ScalarEvent) or (event.implicit[0] and event.value in _CONSTANTS):
            self._refuse("B-YAML-009", "a key must be text", event)
        assert isinstance(level.container, dict)
        if event.value in level.container:
            self._note("B-YAML-014", f"duplicate key {event.value!r}", event)
        level.key = event.value
        self.marks.setdefault((*level.path, event.value), _mark_of(event))

    @staticmethod
    def _attach(level: _Level | None, value: Any, root: list[Any]) -> Path_:
        if level is None:
            root.append(value)
            return ()
        if isinstance(level.container, list):
            level.container.append(value)
            return (*level.path, len(level.container) - 1)
        key, level.key = level.key, None
        assert key is not None
        level.container[key] = value
        return (*level.path, key)

    def _value(self, event: Any) -> Any:
        if isinstance(event, yaml.SequenceStartEvent):
            return []
        if isinstance(event, yaml.MappingStartEvent):
            return {}
        if not event.implicit[0]:
            return event.value
        value = _plain(event.value)
        if isinstance(value, int) and not -(2**63) <= value < 2**64:
            self._note("B-YAML-018", f"the integer {_shorten(event.value)} is over 64 bits", event)
            return 0
        return value


def _mark_of(event: Any) -> Mark:
    return Mark(event.start_mark.line + 1, event.start_mark.column + 1)


def _not_yaml(error: Any, text: str) -> _Problem:
    """Return where and why a parser stopped: a line without a colon where it begins, not at the next one.

    A file that ends too early is wrong at its last character, not a line later.
    """
    mark, reason = getattr(error, "problem_mark", None), getattr(error, "problem", str(error))
    place = Mark(1, 1)
    if mark is not None:
        mark = error.context_mark if error.context == "while scanning a simple key" else mark
        reason = "tab" if text[mark.index : mark.index + 1] == "\t" else reason
        last = text.count("\n")
        ended = mark.line > last
        place = Mark(last + 1, len(text) - text.rfind("\n")) if ended else Mark(mark.line + 1, mark.column + 1)
    what, advice = next((row for words, row in words_in(SLIPS).items() if words in reason), (reason, ""))
    return _Problem(place, "B-YAML-004", f"is not YAML: {what}", advice)


def _plain(text: str) -> Any:
    """Return value of an unquoted scalar by the core rules of YAML 1.2; what is no number is text."""
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _INT.fullmatch(text):
        return int(text) if len(text) <= _MAX_DIGITS else 2**64
    if _HEX.fullmatch(text):
        return int(text, 16)
    if len(text) > _MAX_DIGITS or not _FLOAT.fullmatch(text):
        return text
    number = float(text)
    return number if abs(number) != float("inf") else text
