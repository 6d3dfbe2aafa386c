"""``bench decode --explain`` and ``bench frame new``: what a raw capture says about its own frames."""

from __future__ import annotations

import sys
from collections import Counter
from io import BytesIO
from pathlib import Path

from bench.commands.console import console, named_file
from bench.commands.frame.decode import opened, print_bad
from bench.frame import (
    LOOKED_AT_BYTES,
    Guess,
    LineGuess,
    decode_capture,
    draft,
    guesses,
    line_guess,
    load_frame,
    parse_frame,
    undone,
)  # fmt: skip
from bench.model.errors import ExitStatus, InputError, InputErrors
from bench.session.output import write_file

_SHOWN = 3


def new(capture: Path, name: str, out: Path | None) -> int:
    """Write a first definition from a capture; exit status 1 if its bytes show none.

    Raises: InputError B-FRAME-030 (the capture cannot be read), B-CLI-007 (the file is there, or cannot be written);
    InputErrors where the name is none of a definition.
    """
    head = _head(capture)
    found = _hypotheses(head)
    layer = _layer(head, found)
    if layer or not found:
        sys.stderr.write(f"{layer or _nothing(head)}\n")
        return ExitStatus.VERDICT_FAIL
    text = draft(found[0], head, name)
    parse_frame(text, str(out or name))
    if out is None:
        sys.stdout.write(text)
    elif out.is_file():
        raise InputError("B-CLI-007", "is there already", where=out, next_step="name another file")
    else:
        write_file(out, text)
    sys.stderr.write(f"{_told(found[0])}\n")
    return ExitStatus.PASS


def explain(frame: str, file: Path) -> int:
    """Print what a definition finds in a capture, and what the capture itself shows; exit status 1 if nothing is good.

    Raises: InputErrors of the definition, after the explanation; InputError B-FRAME-030.
    """
    out, head = console(), _head(file)
    refused: InputErrors | None = None
    good = 0
    try:
        definition = load_frame(named_file("frames", frame))
        with file.open("rb") if file.is_file() else BytesIO(head) as stream:
            counted = decode_capture(definition, stream)
        counts = counted.counts
        good = counts.frames
        out.print(f"{definition.name}: {good} good, {counts.bad} bad, {counts.other} other,"
                  f" {counts.skipped_bytes} of {counts.bytes} bytes in no frame")  # fmt: skip
        print_bad(counted)
    except InputErrors as error:
        refused = error
    found = _hypotheses(head)
    if refused is not None and (layer := _layer(head, found)):
        out.print(layer)
    for number, guess in enumerate(found[:_SHOWN]):
        out.print(f"{'as the capture has it' if number == 0 else 'or'}: {_told(guess)}", highlight=False)
    if found:
        out.print("the lines of a definition:")
        sys.stdout.write(draft(found[0], head, Path(frame).stem))
    else:
        out.print(_nothing(head))
    if refused is not None:
        raise refused
    return ExitStatus.PASS if good else ExitStatus.VERDICT_FAIL


def _hypotheses(head: bytes) -> list[Guess | LineGuess]:
    """Return what frames and lines of a capture may be, first what explains most of it."""
    frames = [guess for guess in guesses(head) if _is_definition(guess, head)]
    lines = line_guess(head)
    if lines is None or not _is_definition(lines, head):
        return [*frames]
    first = not frames or (frames[0].check is None and lines.check != "none") or lines.covered > frames[0].covered
    return [lines, *frames] if first else [*frames, lines]


def _layer(head: bytes, found: list[Guess | LineGuess]) -> str:
    """Return what hides frames with a check, where the capture as it is shows none; "" if nothing does."""
    if not any(_has_check(guess) for guess in found):
        for name, before in undone(head):
            guess = next((guess for guess in _hypotheses(before) if _has_check(guess)), None)
            if guess is not None:
                return f"the capture is not as it was sent: {name}; undone, its beginning shows {_told(guess)}"
    return ""


def _has_check(guess: Guess | LineGuess) -> bool:
    return guess.check not in (None, "none")


def _is_definition(guess: Guess | LineGuess, head: bytes) -> bool:
    try:
        parse_frame(draft(guess, head, "draft"), "draft")
    except InputError:
        return False
    return True


def _head(capture: Path) -> bytes:
    """Return the beginning of a capture. Raises: InputError B-FRAME-030."""
    with opened(capture) as stream:
        return stream.read(LOOKED_AT_BYTES)


def _told(guess: Guess | LineGuess) -> str:
    """Return a hypothesis in words."""
    if isinstance(guess, LineGuess):
        begin = f" that begin with {guess.sync.decode()!r}" if guess.sync else ""
        check = f"{guess.check} in hex digits behind {guess.mark!r}" if guess.mark else "no check"
        share = f"{100 * guess.covered:.0f} % of the bytes"
        lines = f"{len(guess.lines)} lines of text{begin}, values between {guess.separator!r}, {share}"
        return f"{lines}; {check}; {_chance(guess)}"
    lengths = Counter(guess.lengths).most_common(4)
    sizes = ", ".join(f"{size} ({count})" for size, count in lengths) + (" …" if len(set(guess.lengths)) > 4 else "")
    where = ""
    if (field := guess.length) is not None:
        order = "" if field.size == 1 else f" {'big' if field.big else 'little'}-endian"
        where = f"; length = u{8 * field.size}{order} at byte {field.at} + {field.plus}"
    check = "no check that is known"
    if (fit := guess.check) is not None:
        place = f"behind it, {fit.trailer} bytes before the end" if fit.at is None else f"at byte {fit.at}"
        order = "" if fit.size == 1 else f", {'big' if fit.big else 'little'}-endian"
        name = " or ".join((fit.name, *fit.also))
        check = f"{name} from byte {fit.start} on, {place}{order}, right in {fit.right} of those tried"
    return (
        f"sync {guess.sync.hex(' ')}, {len(guess.starts)} frames of {sizes} bytes, "
        f"{100 * guess.covered:.0f} % of the bytes{where}; {check}; {_chance(guess)}"
    )


def _chance(guess: Guess | LineGuess) -> str:
    return f"by chance in fewer than one of 10^{min(99, int(-guess.chance))} captures of random bytes"


def _nothing(head: bytes) -> str:
    if not head:
        return "the capture is empty"
    text = "no bytes of the first {} repeat at distances that are constant or that a length field states, so often that"
    return f"{text.format(len(head))} random bytes would not in a million captures; no lines of text with values either"
