"""What docs/session-format.md gives a stranger: its writer and its examples; and a session put together by hand.

Frames are packed by numpy, ``binascii`` and ``zlib`` alone: nothing here comes from ``bench``.
"""

import binascii
import json
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / "docs" / "session-format.md"
NS = 1_000_000_000
CHECKS: Mapping[str, tuple[Callable[[bytes], int], int]] = {
    "crc-16/ibm-3740": (lambda content: binascii.crc_hqx(content, 0xFFFF), 2),
    "crc-32/iso-hdlc": (zlib.crc32, 4),
}


@cache
def _blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)


def documented_writer(**edits: str) -> Callable[..., None]:
    """``write_session`` of the document, its text changed as told."""
    (block,) = _blocks("python")
    for old, new in edits.items():
        assert old in block
        block = block.replace(old, new)
    space: dict[str, Any] = {}
    exec(compile(block, str(DOCUMENT), "exec"), space)
    return space["write_session"]


def documented_standards() -> dict[str, Any]:
    """The register of standards that the document shows."""
    (found,) = (document for block in _blocks("json") if "calibrator" in (document := json.loads(block)))
    return dict(found)


def documented_campaign(analysis: str) -> dict[str, Any]:
    """The section ``campaign`` that the document shows of an analysis."""
    (found,) = (document for block in _blocks("json") if (document := json.loads(block)).get("analysis") == analysis)
    return dict(found)


def packed(
    sync: bytes, body: np.ndarray[Any, Any], check: str, stored: Literal["little", "big"] = "little"
) -> list[bytes]:
    """Frames of the rows of a packed record array; the check runs over everything behind the sync bytes."""
    crc, size = CHECKS[check]
    content, length = body.tobytes(), body.dtype.itemsize
    rows = (content[at : at + length] for at in range(0, len(content), length))
    return [sync + row + crc(row).to_bytes(size, stored) for row in rows]


def shipped(name: str) -> str:
    """Text of a frame definition of this repository."""
    return (ROOT / "frames" / f"{name}.yaml").read_text(encoding="utf-8")


class Session:
    """Everything one stranger's recorder saw; times in seconds of its monotonic clock."""

    def __init__(self, campaign: Mapping[str, Any], links: Mapping[str, str], **manifest: Any) -> None:
        """``links``: link to text of its frame definition, the one that records are cut from first."""
        self.links = {link: f"frames/of_{link}.yaml" for link in links}
        self.texts = {self.links[link]: text for link, text in links.items()}
        self.messages: list[tuple[str, int, bytes]] = []
        self.events: list[tuple[int, str, dict[str, Any]]] = []
        self.records = 0
        self.manifest: dict[str, Any] = {
            "schema": 1, "session": "stranger", "simulated": True, "links": self.links,
            "measurement_link": next(iter(links)), "plan_sha256": "none", "planned": {"prepare_s": 0.0},
            "campaign": dict(campaign), "standards": {}, **manifest,
        }  # fmt: skip

    def frames(self, link: str, t_s: float, content: bytes) -> None:
        """Bytes that a link sent, all received at one time."""
        self.messages.append((f"/link/{link}/rx", round(t_s * NS), content))

    def event(self, kind: str, t_s: float, **fields: Any) -> None:
        """Something that happened."""
        self.events.append((round(t_s * NS), kind, fields))

    def reading(self, t_s: float, role: str, name: str, value: Any, **conditions: Any) -> None:
        """A value of an instrument."""
        self.event("reading", t_s, role=role, name=name, value=value, conditions=conditions)

    def record(
        self, first: int, frames: int, begin_s: float, end_s: float, *, samples: bool = True, **conditions: Any
    ) -> None:
        """A record of the measurement link, taken at its end."""
        self.records += 1
        self.event(
            "record", end_s, number=self.records, link=self.manifest["measurement_link"], first_counter=first,
            frames=frames, t_start_ns=round(begin_s * NS), t_end_ns=round(end_s * NS), samples=samples,
            conditions=conditions,
        )  # fmt: skip

    def without(self, path: Sequence[str]) -> "Session":
        """The same session without a key: of the manifest, of an event of a kind, or of the conditions of records."""
        other = object.__new__(Session)
        other.__dict__ = dict(self.__dict__)
        other.manifest = json.loads(json.dumps(self.manifest))
        other.events = json.loads(json.dumps(self.events))
        root, *keys, last = path
        places = [other.manifest] if root == "manifest" else [f for _, kind, f in other.events if kind == root]
        gone = 0
        for place in places:
            for key in keys:
                place = place.get(key, {}) if isinstance(place, dict) else place[int(key)]
            gone += isinstance(place, dict) and place.pop(last, self) is not self
        assert gone, path
        return other

    def renamed(self, link: str, field: str) -> "Session":
        """The same session whose frame definition has another name for a field."""
        other = object.__new__(Session)
        other.__dict__ = dict(self.__dict__)
        text = self.texts[self.links[link]]
        assert re.search(rf"\b{field}\b", text)
        other.texts = self.texts | {self.links[link]: re.sub(rf"\b{field}\b", f"my_{field}", text)}
        return other

    def content(self) -> tuple[dict[str, Any], dict[str, str], list[tuple[str, int, bytes]]]:
        """Manifest, texts, and messages in order of time, as the documented writer takes them."""
        said = [
            ("/event", t_ns, json.dumps({"kind": kind, "fields": fields}).encode())
            for t_ns, kind, fields in self.events
        ]
        return self.manifest, self.texts, sorted([*self.messages, *said], key=lambda message: message[1])

    def write(self, folder: Path) -> Path:
        """Write the session with the documented writer."""
        folder.mkdir(parents=True, exist_ok=True)
        documented_writer()(folder, *self.content())
        return folder
