"""Blocks of any bytes as an instrument sends them: ``#``, a digit, that many digits of length, the bytes, a line feed.

Source: IEEE Std 488.2, 8.7.9 (definite-length arbitrary block response data).
"""

from __future__ import annotations

_LONGEST_HEADER = 11  # "#9" and nine digits


class CutOffError(ValueError):
    """A block that ends before its length; ``content`` is what came of it."""

    def __init__(self, content: bytes, length: int) -> None:
        super().__init__(f"{len(content)} of {length} bytes" if length else "a block that ends in its header")
        self.content = content


def block_content(reply: bytes | bytearray) -> bytes:
    """The bytes inside a definite-length block; what follows it is the line feed that ends the message.

    Raises: CutOffError if it is shorter than it says; ValueError if it is no such block.
    """
    if not reply:
        raise CutOffError(b"", 0)
    if reply[:1] != b"#":
        raise ValueError("a block is due, and it begins with '#'")
    header = bytes(reply[:_LONGEST_HEADER])
    digits = header[1:2]
    if digits == b"":
        raise CutOffError(b"", 0)
    if digits not in b"123456789":
        raise ValueError("a block of definite length is due")
    begin = 2 + int(digits)
    text = header[2:begin]
    if text and not text.isdigit():
        raise ValueError("the length of the block is no number")
    if len(text) < int(digits):
        raise CutOffError(b"", 0)
    length = int(text)
    content = bytes(reply[begin : begin + length])
    if len(content) < length:
        raise CutOffError(content, length)
    if len(reply) > begin + length and bytes(reply[begin + length :]).strip(b"\r\n"):
        raise ValueError("more than one block has come")
    return content
