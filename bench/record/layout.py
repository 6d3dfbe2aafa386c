"""Layout of a session: topics, the envelope round every payload, canonical JSON (docs/session-format.md).

An envelope is 20 bytes, little endian: u32 CRC, u64 running number of the session, u64 monotonic time in ns. The CRC
is CRC-32/ISO-HDLC over the remaining 16 bytes and the payload, started from the CRC of the topic: zeros are never a
message, and a message cannot change its topic.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from bench.model.errors import SessionDamaged

PROFILE = "inertial-bench/1"
LIBRARY = "inertial-bench recorder 1"
ENCODING = "inertial-bench/1"

MANIFEST = "/manifest"
TEXT = "/text/"
LINK = "/link/"
INSTRUMENT = "/instrument/"
EVENT = "/event"
CLOCK = "/clock"
CHAIN = "/chain"
CHAIN_START = bytes(32)

_PREFIXES = (LINK, INSTRUMENT, TEXT)
_EXACT = frozenset({MANIFEST, EVENT, CLOCK, CHAIN})
_STAMP = struct.Struct("<QQ")


class Message(NamedTuple):
    """One message of a session; ``t_ns`` is monotonic time, ``sequence`` runs through the whole session."""

    topic: str
    sequence: int
    t_ns: int
    payload: bytes

    def document(self) -> Any:
        """Return the payload as JSON. Raises: SessionDamaged B-REC-014 if it is none."""
        try:
            return json.loads(self.payload)
        except ValueError as error:
            raise self._not_as_documented(str(error)) from error

    def text(self) -> str:
        """Return the payload as text. Raises: SessionDamaged B-REC-014 if it is not UTF-8."""
        try:
            return self.payload.decode()
        except ValueError as error:
            raise self._not_as_documented(str(error)) from error

    def event(self) -> tuple[str, dict[str, Any]]:
        """Kind and fields of an event. Raises: SessionDamaged B-REC-014 if it is none."""
        document = self.document()
        if not isinstance(document, dict) or not isinstance(document.get("fields"), dict) or "kind" not in document:
            raise self._not_as_documented("an event has a kind and fields")
        return str(document["kind"]), document["fields"]

    def _not_as_documented(self, why: str) -> SessionDamaged:
        return SessionDamaged(
            "B-REC-014",
            f"the content is not what its topic promises: {why}",
            where=f"message {self.sequence} of {self.topic}",
            next_step="docs/session-format.md says what each topic holds",
        )


def segment_name(number: int) -> str:
    """File name of a segment, counted from 1."""
    return f"session.{number:04d}.mcap"


def is_bench_topic(topic: str) -> bool:
    """Return True if the topic belongs to the layout; other topics of a file are ignored."""
    return topic in _EXACT or topic.startswith(_PREFIXES)


def matches(topic: str, selection: frozenset[str]) -> bool:
    """Return True if ``topic`` is selected; a selected name that ends in "/" stands for all topics below it."""
    return topic in selection or any(topic.startswith(name) for name in selection if name.endswith("/"))


def payload_kind(topic: str) -> str:
    """Return what a payload is: ``raw`` bytes, ``text`` (UTF-8) or ``json`` (canonical JSON)."""
    if topic.startswith(LINK):
        return "raw"
    return "text" if topic.startswith(TEXT) else "json"


def topic_seed(topic: str) -> int:
    """Start value of the envelope's CRC for one topic."""
    return zlib.crc32(topic.encode())


def envelope_crc(seed: int, sequence: int, t_ns: int, payload: bytes) -> int:
    """CRC of an envelope: the running number, the time and the payload, started from the topic's CRC."""
    return zlib.crc32(payload, zlib.crc32(_STAMP.pack(sequence, t_ns), seed))


def _plain(value: object) -> Any:
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, (set, frozenset)):
        return sorted(value)
    item = getattr(value, "tolist", None)
    if item is not None:
        return item()
    return str(value)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return _finite(_plain(value)) if hasattr(value, "tolist") else value


_ENCODER = json.JSONEncoder(
    sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False, check_circular=False, default=_plain
)


def _encoding() -> Callable[[Any], str]:
    """Return what encodes JSON; made once, where ``JSONEncoder`` makes the same anew for each text."""
    make = getattr(json.encoder, "c_make_encoder", None)
    if make is None:  # a Python without it
        return _ENCODER.encode
    parts_of = make(None, _plain, json.encoder.encode_basestring, None, ":", ",", True, False, False)  # as _ENCODER
    return lambda value: "".join(parts_of(value, 0))


_encode = _encoding()


def canonical_json(value: Any) -> bytes:
    """Return JSON with sorted keys, no blanks, UTF-8; numbers that are not finite become null."""
    try:
        return _encode(value).encode()
    except (ValueError, TypeError):
        return _ENCODER.encode(_finite(value)).encode()
