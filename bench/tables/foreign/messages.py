"""Messages of one topic as rows: MCAP files with JSON, bags of ROS 1 and ROS 2, also within MCAP.

A field of a message is a column by its path, ``position.x``; elements of a list are ``position[0]``.
``log_time`` is when the recorder got the message, ``header.stamp`` when it was stamped, both in ns since 1970.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.model.errors import InputError
from bench.plan import suggestion
from bench.tables.library import library

LOG_TIME = "log_time"
_MOST_ELEMENTS = 64  # of a list; longer ones are images and scans
_NS = 1_000_000_000
Fields = dict[str, object]


@dataclass(frozen=True)
class MessageTable:
    """Messages of one topic. ``names``: fields of the first one.   ``read``: opens the file and yields the fields.

    ``broken``: parts of the file that cannot be read.
    """

    names: Sequence[str]
    read: Callable[[], Iterator[Fields]]
    broken: int = 0

    def rows(self, names: Sequence[str]) -> Iterator[Sequence[object]]:
        """Yield values of some fields, message by message; one that a message lacks is an empty text."""
        for fields in self.read():
            yield [fields.get(name, "") for name in names]


def mcap_table(path: Path, topic: str | None) -> MessageTable:
    """Return the messages of a topic of an MCAP file whose encoding is JSON or that of ROS 2.

    Of a file that is cut, or has broken chunks, what is whole; then all messages of the topic are held in memory.
    Raises: InputError B-IMP-011 for the topic or another encoding, B-TAB-001 without the library mcap (or rosbags).
    """
    make_reader = library("mcap.reader").make_reader
    broken: list[object] = []
    channels = {record.topic: record for record in _records(path, broken) if hasattr(record, "topic")}
    if broken and not channels:
        raise ValueError("it is cut off or broken at its begin")
    chosen = _chosen(path, topic, channels)
    encoding = channels[chosen].message_encoding
    if encoding == "cdr":
        return bag_table(path, chosen)
    if encoding != "json":
        raise _wrong_topic(path, f"messages of {chosen!r} are encoded as {encoding!r}; json and cdr (ROS 2) are read")

    def read() -> Iterator[Fields]:
        with path.open("rb") as file:
            messages: Iterator[Any] = (message for _, _, message in make_reader(file).iter_messages(topics=[chosen]))
            if broken:
                told = (record for record in _records(path, []) if type(record).__name__ == "Message")
                mine = (message for message in told if message.channel_id == channels[chosen].id)
                messages = iter(sorted(mine, key=lambda message: int(message.log_time)))
            for message in messages:
                yield {LOG_TIME: message.log_time} | dict(_flat("", json.loads(message.data)))

    return _table(path, chosen, read, len(broken))


def _records(path: Path, broken: list[object]) -> Iterator[Any]:
    """Yield records of an MCAP file in its order, without those in broken or missing parts, which are noted."""
    streams = library("mcap.stream_reader")
    with path.open("rb") as file:
        try:
            for record in streams.StreamReader(file, emit_chunks=True).records:
                try:
                    is_chunk = hasattr(record, "uncompressed_crc")
                    within = streams.breakup_chunk(record, validate_crc=True) if is_chunk else [record]
                except Exception as error:  # whatever the library raises
                    broken.append(error)
                else:
                    yield from within
        except Exception as error:  # nothing behind it can be told
            broken.append(error)


def bag_table(path: Path, topic: str | None) -> MessageTable:
    """Return the messages of a topic of a bag of ROS 1 or ROS 2.

    Raises: InputError B-IMP-011 for the topic, B-TAB-001 without the library rosbags.
    """
    chosen = _chosen(path, topic, bag_topics(path))

    def read() -> Iterator[Fields]:
        with _bag(path) as bag:
            connections = [connection for connection in bag.connections if connection.topic == chosen]
            for connection, t_ns, raw in bag.messages(connections):
                yield {LOG_TIME: t_ns} | dict(_flat("", bag.deserialize(raw, connection.msgtype)))

    return _table(path, chosen, read)


def bag_topics(path: Path) -> set[str]:
    """Return the topics of a bag. Raises: InputError B-TAB-001 without the library rosbags."""
    with _bag(path) as bag:
        return {connection.topic for connection in bag.connections}


def mcap_topics(path: Path) -> set[str]:
    """Return the topics of an MCAP file. Raises: InputError B-TAB-001 without the library mcap."""
    return {record.topic for record in _records(path, []) if hasattr(record, "topic")}


def _bag(path: Path) -> Any:
    library("rosbags")
    stores = library("rosbags.typesys")
    types = stores.get_typestore(stores.Stores.LATEST)  # of bags that do not hold their types
    return library("rosbags.highlevel").AnyReader([path], default_typestore=types)


def _table(path: Path, topic: str, read: Callable[[], Iterator[Fields]], broken: int = 0) -> MessageTable:
    first = next(read(), None)
    if first is None:
        raise _wrong_topic(path, f"the topic {topic!r} holds no message")
    return MessageTable(tuple(first), read, broken)


def _chosen(path: Path, topic: str | None, known: Iterable[str]) -> str:
    topics = sorted(known)
    if topic is None:
        if len(topics) == 1:
            return topics[0]
        raise _wrong_topic(path, f"holds {len(topics)} topics: {', '.join(topics[:20]) or 'none'}")
    if topic in topics:
        return topic
    raise _wrong_topic(path, f"holds no topic {topic!r}{suggestion(topic, topics[:40])}")


def _wrong_topic(path: Path, why: str) -> InputError:
    return InputError("B-IMP-011", why, where=str(path), next_step="name one in the mapping: 'file: {topic: /sensor}'")


def _flat(name: str, value: Any) -> Iterator[tuple[str, object]]:
    """Yield the numbers and texts of a message with their paths."""
    if isinstance(value, str | int | float):
        yield name, value
    elif isinstance(value, dict):
        stamp = _stamp_ns(value)
        if stamp is not None:
            yield name, stamp
        for key, part in value.items():
            yield from _flat(f"{name}.{key}" if name else str(key), part)
    elif hasattr(value, "tolist") or isinstance(value, list | tuple):
        parts = value.tolist() if hasattr(value, "tolist") else value
        for place, part in enumerate(parts if isinstance(parts, list | tuple) and len(parts) <= _MOST_ELEMENTS else ()):
            yield from _flat(f"{name}[{place}]", part)
    elif hasattr(value, "__dataclass_fields__"):
        yield from _flat(name, {key: getattr(value, key) for key in value.__dataclass_fields__ if key[:2] != "__"})


def _stamp_ns(value: dict[str, Any]) -> int | None:
    """Return a time of ROS, seconds and nanoseconds apart, as one whole number."""
    seconds, rest = value.get("sec"), value.get("nanosec", value.get("nsec"))
    if len(value) == 2 and isinstance(seconds, int) and isinstance(rest, int):
        return seconds * _NS + rest
    return None
