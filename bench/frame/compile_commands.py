"""From the ``commands`` of a frame file to the layouts of their payloads; every mistake with its position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bench.frame.commands import CommandLayout, PayloadLayout
from bench.frame.compile_fields import Fail, place_fields
from bench.frame.layout import Message
from bench.frame.schema import CommandSpec, FieldSpec, FrameSpec
from bench.model.yamlio import Path_

COMMAND, ANSWER = "command", "answer"
_OF_FRAMES = ("role", "per", "bits", "constant")  # keys that mean something in a stream of frames only


def compile_commands(spec: FrameSpec, messages: Sequence[Message], fail: Fail) -> dict[str, CommandLayout]:
    """Layouts by name; mistakes go to ``fail`` (B-FRAME-014, and those of fields)."""
    if spec.commands is None:
        return {}
    _check_messages(messages, fail)
    found: dict[str, CommandLayout] = {}
    for name, part in spec.commands.items():
        path: Path_ = ("commands", name)
        if any(part.code == other.code for other in found.values()):
            fail("B-FRAME-014", (*path, "code"), f"{name}: the code 0x{part.code:02x} is taken", "choose another code")
        found[name] = _layout(name, part, path, spec.endian, fail)
    return found


def _layout(name: str, part: CommandSpec, path: Path_, endian: str, fail: Fail) -> CommandLayout:
    def payload(key: str, fields: tuple[FieldSpec, ...]) -> PayloadLayout:
        where = (*path, key)
        for index, field in enumerate(fields):
            for word in _OF_FRAMES:
                if getattr(field, word) is not None:
                    text = f"{field.name}: {word!r} makes no sense in the payload of a command"
                    fail("B-FRAME-014", (*where, index, word), text, f"remove {word!r}")
        return PayloadLayout(f"{key} of {name!r}", tuple(place_fields(fields, where, (), 0, endian, fail)))

    request, answer = payload("request", part.request), payload("answer", part.answer)
    return CommandLayout(name, part.code, part.timeout, request, answer)


def _check_messages(messages: Sequence[Message], fail: Fail) -> None:
    """What a command travels in: messages ``command`` and ``answer`` with sequence, command and a payload."""
    due: Mapping[str, tuple[str, ...]] = {COMMAND: ("sequence", "command"), ANSWER: ("sequence", "command", "status")}
    for name, fields in due.items():
        message = next((one for one in messages if one.name == name), None)
        missing = [field for field in fields if message is None or field not in message.by_name]
        if message is None or missing or message.rest is None or message.rest.name != "payload":
            what = f"fields {', '.join(fields)} and payload (bytes, rest)"
            text = f"'commands' needs a message {name!r} with the {what}"
            fail("B-FRAME-014", ("commands",), text, "docs/adding-a-frame.md shows such a file")
