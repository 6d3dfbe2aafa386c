"""From a checked YAML document to a Layout; all mistakes at once, each with file:line:column."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from dataclasses import replace

from bench.frame.commands import CommandLayout, compile_commands
from bench.frame.compiling.fields import Placed, place
from bench.frame.crc import (
    ALIASES,
    CATALOGUE,
    CHECKSUM_ALIASES,
    CHECKSUMS,
    Check,
    Crc,
    CrcModel,
    find_checksum,
    find_model,
)
from bench.frame.layout import OFFSET, Field, Layout, Message, Part, Span
from bench.frame.parts import blank_row
from bench.frame.spec import MAX_FRAME_BYTES, AnyField, CheckSpec, Endian, FieldSpec, FrameSpec, ItemsSpec
from bench.model.errors import InputError, InputErrors
from bench.model.yamlio import Document, Path_

ONLY_MESSAGE = "frame"
_NUMBERED = re.compile(r"(.+)_([1-9]\d{0,5})")
_OF_NUMBERS = "+-."  # characters that numbers are written with
_FORMS = {"hex": "an unsigned integer", "text": "bytes"}  # the others are for f64
_NEXT = "docs/adding-a-frame.md says what each key may have"
_PARAMETERS = ("width", "poly", "init", "refin", "refout", "xorout")


class _Compiler:
    def __init__(self, document: Document[FrameSpec]) -> None:
        self.document = document
        self.spec = document.model
        self.errors: list[InputError] = []
        self._endian: Endian = self.spec.endian or "big"

    def fail(self, code: str, path: Path_, message: str, next_step: str = "") -> None:
        where = self.document.where(path)
        if not any((error.code, error.where) == (code, where) == ("B-FRAME-008", where) for error in self.errors):
            self.errors.append(InputError(code, message, where=where, next_step=next_step or _NEXT))

    def build(self) -> tuple[Layout, dict[str, CommandLayout]]:
        spec = self.spec
        front = spec.sync_at or 0
        self._sync_end = front + len(spec.sync)
        start = 0 if front else self._sync_end
        sync = range(front, self._sync_end) if front else range(0)
        common = place(self._written(spec.fields), ("fields",), start, self._endian, self.fail, sync)
        check = self._check(spec.crc)
        self._check_form(common)
        self._common_end = common.end
        self._length = self._reference("length", spec.length.field if spec.length else None, common)
        self._type = self._reference("type", spec.type.field if spec.type else None, common)
        self._check_field = self._holder(check, common)
        self._tail = (0 if spec.crc.field else check.size) + len(spec.trailer or ())
        messages = self._messages(common)
        self._others = self._unlisted(common)
        self._check_lengths(messages)
        if spec.sync_at and not spec.sync:
            self.fail("B-FRAME-006", ("sync_at",), "there are no sync bytes", "leave it out")
        told = spec.sync or spec.length or spec.escape or spec.lines
        if not told and not (check.size and len(messages) == 1 and messages[0].length):
            text = "frames without sync bytes must carry their length, or be of one length and have a check"
            self.fail("B-FRAME-006", ("sync",), text, "give sync bytes, or 'length: {field: ..., plus: ..., max: ...}'")
        commands = compile_commands(spec, messages, self.fail)
        if self.errors:
            raise InputErrors(self.errors)
        return self._layout(common, messages, check), commands

    def _written(self, specs: Sequence[AnyField]) -> list[AnyField]:
        """Return fields; in lines bytes are text."""
        if self.spec.lines is None:
            return list(specs)
        is_text = [isinstance(spec, FieldSpec) and spec.type == "bytes" for spec in specs]
        return [spec.model_copy(update={"form": "text"}) if text else spec
                for spec, text in zip(specs, is_text, strict=True)]  # fmt: skip

    def _layout(self, common: Placed, messages: list[Message], check: Check) -> Layout:
        spec = self.spec
        length_field, length_bits = self._length
        type_field, type_bits = self._type
        own = any(isinstance(field, FieldSpec) and field.role == "own_counter" for field in spec.fields)
        pattern = bytes(spec.sync)
        for field in messages[0].fields if len(messages) == 1 else common.fields:
            if field.offset < self._sync_end:
                continue
            if field.constant is None:
                break
            pattern += field.constant
        ends = [item.end for item in (length_field, type_field) if item is not None]
        if spec.length is None and spec.escape is None and messages[0].parts:
            ends.append(messages[0].head)
        return Layout(
            sync=bytes(spec.sync),
            pattern=pattern,
            header=max([self._sync_end - len(spec.sync) + len(pattern), *ends]),
            messages=tuple(messages),
            check=check,
            stored_big=self._check_field.big if self._check_field else (spec.crc.stored or self._endian) == "big",
            length_field=length_field,
            length_plus=spec.length.plus if spec.length else 0,
            max_length=self._longest(messages),
            type_field=type_field,
            shared_counter=bool(spec.messages) and not own and any(field.counter for field in common.fields),
            own_counters=own,
            rate_Hz=spec.rate,
            silence_s=spec.silence,
            length_times=spec.length.times if spec.length else 1,
            length_bits=length_bits,
            type_bits=type_bits,
            check_field=self._check_field,
            trailer=bytes(spec.trailer or ()),
            unlisted=self._others,
            escape=spec.escape or "",
            lines=spec.lines,
            sync_at=spec.sync_at or 0,
        )

    def _longest(self, messages: list[Message]) -> int:
        if self.spec.length:
            return self.spec.length.max
        open_ended = any(message.rest or any(part.open_ended for part in message.parts) for message in messages)
        if open_ended or self.spec.lines is not None or self.spec.other:
            return MAX_FRAME_BYTES
        return max(message.body + self._tail for message in messages)

    def _unlisted(self, common: Placed) -> Message | None:
        """Return the common fields as a message of any length, where frames of other types are counted."""
        if not self.spec.other:
            return None
        return Message("(other)", common.fields, common.end, 0, *self._coverage(common, "other", whole=False))

    def _holder(self, check: Check, common: Placed) -> Field | None:
        """Return the field that holds the check."""
        name = self.spec.crc.field
        field = next((item for item in common.fixed if item.name == name), None)
        if name is None or (
            field is not None
            and field.width == 8 * check.size
            and field.packed is None
            and field.constant is None
            and (field.kind, field.count, field.counter) == ("u", None, False)
            and field not in (self._length[0], self._type[0])
        ):
            return field
        text = f"the check needs an unsigned integer of {8 * check.size} bits of its own among the common fields"
        self.fail("B-FRAME-008", ("crc", "field"), f"{text}, not {name!r}")
        return None

    def _reference(self, key: str, part: str | None, common: Placed) -> tuple[Field | None, Span | None]:
        """Return the field and the bits of it that say the length or the type."""
        if part is None:
            return None, None
        name, _, bits = part.partition(".")
        field = next((item for item in common.fixed if item.name == name), None)
        if self.spec.lines and key == "type":
            if field is None or field.kind != "b" or bits:
                self.fail("B-FRAME-006", (key, "field"), f"the type of a line must be common bytes, not {part!r}")
            return field, None
        if field is None or field.kind != "u" or field.count is not None or field.size > 4:
            message = f"the {key} field {name!r} must be one unsigned integer of up to 32 bits among the common fields"
            self.fail("B-FRAME-006", (key, "field"), message)
            return None, None
        if bits and bits not in field.bits:
            self.fail("B-FRAME-006", (key, "field"), f"{name!r} has no bits {bits!r}", "name them in its 'bits'")
        return field, field.bits.get(bits)

    def _messages(self, common: Placed) -> list[Message]:
        spec = self.spec
        delimited = spec.length is not None or spec.escape is not None or spec.lines is not None
        if spec.other and (spec.messages is None or not delimited):
            text = "'other' needs messages and a length field: else nothing says how long an unlisted frame is"
            self.fail("B-FRAME-007", ("other",), text, "leave it out")
        if spec.messages is None:
            if spec.type:
                self.fail("B-FRAME-007", ("type",), "there are no messages that it could tell apart", "leave it out")
            return [self._message(ONLY_MESSAGE, common, None)]
        if not spec.messages or spec.type is None or spec.golden is not None or spec.expect is not None:
            advice = "give 'type', and 'golden' and 'expect' inside each message"
            self.fail("B-FRAME-007", ("messages",), "messages need a type field and golden frames of their own", advice)
        if common.parts or any(field.rest for field in common.fields):
            text = "what stands at no fixed place cannot stand among the common fields of messages"
            self.fail("B-FRAME-015", ("fields",), text, "put it into each message")
        found: list[Message] = []
        for name, part in spec.messages.items():
            path: Path_ = ("messages", name)
            fields = place(self._written(part.fields), (*path, "fields"), common, self._endian, self.fail)
            if any(part.value in (other.type_value, other.type_text) for other in found):
                self.fail("B-FRAME-007", (*path, "value"), f"{name}: the type value {part.value} is taken")
            if isinstance(part.value, str) or spec.lines:
                found.append(replace(self._message(name, fields, None), type_text=self._type_text(part.value, path)))
                continue
            type_field, bits = self._type
            if type_field is not None and part.value >= 1 << (bits[1] if bits else type_field.width):
                message = f"{name}: the type value {part.value} does not fit {spec.type.field if spec.type else ''!r}"
                self.fail("B-FRAME-007", (*path, "value"), message)
            found.append(replace(self._message(name, fields, part.value), extra=bytes(part.extra or ())))
            if part.extra and spec.other:
                text = f"{name}: of frames that are not listed nobody knows the extra bytes of the check"
                self.fail("B-FRAME-007", (*path, "extra"), text, "list all messages, and leave 'other' out")
        return found

    def _type_text(self, value: int | str, path: Path_) -> str:
        """Return the type of a line."""
        field, lines = self._type[0], self.spec.lines
        room = field.length if field else MAX_FRAME_BYTES
        if lines is None or not isinstance(value, str):
            kind = "a whole number" if lines is None else "text in quotes"
            self.fail("B-FRAME-007", (*path, "value"), f"the type value {value!r} must be {kind}")
        elif len(value) > room or set(value) & set(lines.separator):
            text = f"the type value {value!r} is no value of {room} characters"
            self.fail("B-FRAME-007", (*path, "value"), text)
        return str(value)

    def _check_form(self, common: Placed) -> None:
        """Check that what lines cannot have, and what frames without them need, is not mixed."""
        spec, lines = self.spec, self.spec.lines
        self._check_form_of(spec.fields, ("fields",))
        for name, part in (spec.messages or {}).items():
            self._check_form_of(part.fields, ("messages", name, "fields"))
        if lines is None:
            if spec.endian is None:
                self.fail("B-FRAME-006", (), "the definition states no order of bytes", "add 'endian: big' or 'little'")
            return
        for key in ("length", "escape", "trailer", "sync_at"):
            if getattr(spec, key) is not None:
                self.fail("B-FRAME-006", (key,), f"lines have no {key!r}", "leave it out")
        if spec.crc.field is not None or spec.crc.stored is not None:
            key = "stored" if spec.crc.field is None else "field"
            self.fail(
                "B-FRAME-008", ("crc", key), "the check of a line stands at its end, in hex digits", "leave it out"
            )
        if (spec.crc.name == "none") != (lines.check is None):
            text = "lines with a check need the character before it" if lines.check is None else "there is no check"
            self.fail(
                "B-FRAME-008", ("lines",), text, "give 'check: \"*\"' in 'lines' and a check in 'crc', or neither"
            )
        first, last = spec.crc.over or ("sync", "end")
        if first not in ("sync", common.fields[0].name) or last != "end":
            text = f"the check of a line covers it from 'sync' or from {common.fields[0].name!r} to 'end'"
            self.fail("B-FRAME-008", ("crc", "over"), text)
        if not all(0x20 < byte < 0x7F for byte in spec.sync):
            self.fail("B-FRAME-006", ("sync",), "a line begins with printable characters")

    def _check_form_of(self, fields: Sequence[AnyField], path: Path_) -> None:
        for index, field in enumerate(fields):
            if not isinstance(field, FieldSpec):
                if self.spec.lines:
                    self.fail("B-FRAME-015", (*path, index), "a line has no groups, optional parts or items")
                if isinstance(field, ItemsSpec):
                    for name, item in field.of.items():
                        self._check_form_of(item.fields, (*path, index, "of", name, "fields"))
                else:
                    self._check_form_of(field.fields, (*path, index, "fields"))
                continue
            if self.spec.lines and field.type != "bytes" and set(self.spec.lines.separator) & set(_OF_NUMBERS):
                text = f"{field.name}: numbers are written with '+', '-' and '.', which separate the values here"
                self.fail("B-FRAME-006", ("lines", "separator"), text, "read the values as bytes")
            self._check_form_of_one(field, (*path, index))
            if field.type[0] in "ui" and int(field.type[1:]) % 8 and self.spec.lines:
                text = f"{field.name}: a number of a line has 8, 16, ... 64 bits"
                self.fail("B-FRAME-002", (*path, index, "type"), text, "take the next type that holds its values")
            if field.count == "rest" and self.spec.lines:
                text = f"{field.name}: a line has no 'rest'"
                self.fail("B-FRAME-002", (*path, index, "count"), text, "give the greatest number of characters")

    def _check_form_of_one(self, field: FieldSpec, path: Path_) -> None:
        if field.form is None:
            return
        kind = _FORMS.get(field.form, "f64")
        fits = field.type[0] == "u" if field.form == "hex" else field.type == kind
        if field.form != "text" and not self.spec.lines:
            text = f"{field.name}: the form {field.form!r} is for lines of text"
            self.fail("B-FRAME-002", (*path, "form"), text, "leave it out")
        elif not fits:
            text = f"{field.name}: the form {field.form!r} is for {kind}, not for {field.type}"
            self.fail("B-FRAME-002", (*path, "form"), text, f"make its type {'u16' if kind[0] == 'a' else kind}")

    def _check_columns(self, name: str, fields: Sequence[Field]) -> None:
        """Check that no two columns of a table have one name: elements of an array or a group have numbers."""
        path = ("messages", name) if self.spec.messages else ("fields",)
        arrays = {field.name: field.count or 0 for field in fields if field.count is not None and field.kind != "b"}
        numbered = [match for field in fields if (match := _NUMBERED.fullmatch(field.name))]
        taken = [match[0] for match in numbered if int(match[2]) <= arrays.get(match[1], 0)]
        taken += [field.name for field in fields if field.name == OFFSET]
        for column in taken:
            text = f"a table of {name!r} would have the column {column!r} twice"
            self.fail("B-FRAME-001", path, text, f"rename the field {column!r}")

    def _message(self, name: str, placed: Placed, type_value: int | None) -> Message:
        self._check_columns(name, placed.fields)
        start, stop = self._coverage(placed, name)
        varies = placed.parts or placed.fields[-1].rest or self.spec.lines
        parts, head = placed.parts, placed.head
        if self.spec.length and self.spec.length.cut and not varies:
            head = self._common_end
            parts = (Part("cut", name, head, placed.end - head),)
        length = 0 if varies or parts else placed.end + self._tail
        message = Message(name, placed.fields, placed.end, length, start, stop, type_value)
        if not parts:
            return message
        message = replace(message, parts=parts, head=head)
        return replace(message, blank=blank_row(message))

    def _coverage(self, placed: Placed, message: str, whole: bool = True) -> tuple[int, int | None]:
        """Return the bytes covered; ``whole``: nothing follows these fields but check and trailer."""
        fields = placed.fields
        known = {field.name: field for field in placed.fixed}
        bounds: list[int | None] = []
        for index, name in enumerate(self.spec.crc.over or ("sync", "end")):
            field = known.get(name)
            if index == 1 and whole and name == fields[-1].name:
                bounds.append(None)
                continue
            if name == "sync" and index == 0:
                bounds.append(self.spec.sync_at or 0)
            elif name == "end" and index == 1:
                bounds.append(None)
            elif field is None or (index == 1 and field.rest):
                text = f"the check covers {name!r}, which is no field at a fixed place of the message {message!r}"
                close = difflib.get_close_matches(name, known, 1)
                self.fail("B-FRAME-008", ("crc", "over", index), text, f"did you mean {close[0]!r}?" if close else "")
                bounds.append(None)
            else:
                bounds.append(field.offset if index == 0 else field.end)
        start = bounds[0] or 0
        if bounds[1] is not None and bounds[1] <= start:
            self.fail("B-FRAME-008", ("crc", "over"), f"{self.spec.crc.over} runs backwards in {message!r}")
        own, stop = self._check_field, bounds[1] or (0 if fields[-1].rest else placed.end)
        if own and own.offset <= start < stop <= own.end:
            self.fail("B-FRAME-008", ("crc", "over"), f"the check covers nothing but itself in {message!r}")
        return start, bounds[1]

    def _check_lengths(self, messages: list[Message]) -> None:
        length = self.spec.length
        for message in messages:
            if message.parts and message.body > MAX_FRAME_BYTES:
                text = f"{message.name!r} with all that 'max' allows is {message.body} bytes long, the limit is"
                self.fail("B-FRAME-015", ("fields",), f"{text} {MAX_FRAME_BYTES}", "give the groups a smaller 'max'")
            shortest = message.least + self._tail
            if self._needs_length(message):
                text = f"{message.name!r} has contents that vary, so the frame must carry its length"
                self.fail("B-FRAME-006", ("length",), text, "add 'length: {field: ..., plus: ..., max: ...}'")
            limit = MAX_FRAME_BYTES if length is None else length.max
            if shortest > limit:
                text = f"{message.name!r} is {shortest} bytes long, the limit is {limit}"
                self.fail("B-FRAME-006", ("length", "max") if length else ("fields",), text)

    def _needs_length(self, message: Message) -> bool:
        """Return whether neither delimiters nor counts and flags in front of all parts say how long a frame is."""
        if self.spec.length is not None or self.spec.escape is not None or self.spec.lines is not None:
            return False
        if message.rest is not None or (message.parts and self.spec.messages is not None):
            return True
        saying = [part.by for part in message.parts if part.by is not None]
        behind = any(field.end > message.head for field in saying)
        return behind or any(part.open_ended for part in message.parts)

    def _check(self, spec: CheckSpec) -> Check:
        given = [key for key in _PARAMETERS if getattr(spec, key) is not None]
        if (spec.over is None) != (spec.name == "none"):
            text = "a check covers something: 'over' is missing" if spec.over is None else "no check covers nothing"
            self.fail("B-FRAME-008", ("crc",), text, "give 'over: [first, last]' with every check but 'none'")
        if spec.name is not None:
            if given:
                text = f"has a name and the parameter {given[0]!r}"
                self.fail("B-FRAME-009", ("crc", given[0]), text, "keep the name or all six parameters")
            return self._named_check(spec.name)
        missing = [key for key in _PARAMETERS if key not in given]
        if missing:
            text = f"has no name and lacks {', '.join(missing)}"
            self.fail("B-FRAME-009", ("crc",), text, "give a name of the catalogue or all six parameters")
            return CHECKSUMS["xor-8"]
        width = spec.width or 1
        for key in ("poly", "init", "xorout"):
            if getattr(spec, key) >= 1 << width:
                self.fail("B-FRAME-009", ("crc", key), f"{key} is wider than {width} bits")
        if spec.poly == 0:
            self.fail("B-FRAME-009", ("crc", "poly"), "the polynomial must not be 0")
        mask = (1 << width) - 1
        poly, init, xorout = ((getattr(spec, key) or 0) & mask for key in ("poly", "init", "xorout"))
        return Crc(CrcModel("custom", width, poly, init, bool(spec.refin), bool(spec.refout), xorout))

    def _named_check(self, name: str) -> Check:
        checksum = find_checksum(name)
        if checksum is not None:
            return checksum
        key = name.lower()
        model = find_model(key)
        if model is None:
            close = difflib.get_close_matches(key, [*CATALOGUE, *ALIASES, *CHECKSUMS, *CHECKSUM_ALIASES], 3)
            advice = f"did you mean {' or '.join(close)}?" if close else "use a name of the CRC catalogue"
            self.fail("B-FRAME-010", ("crc", "name"), f"{name!r} is no known CRC or checksum", advice)
            return CHECKSUMS["xor-8"]
        return Crc(model)


def compile_frame(document: Document[FrameSpec]) -> tuple[Layout, dict[str, CommandLayout]]:
    """Compile a frame file: the layout of its frames, and its commands by name.

    Raises: InputErrors (B-FRAME-001 to 010, 014) with every mistake found, each with its position.
    """
    return _Compiler(document).build()
