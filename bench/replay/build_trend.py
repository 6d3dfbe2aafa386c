"""Makes the trend of a session again from its raw bytes: of older sessions, of those of other software, of lost ones.

``python -m bench.replay.build_trend SESSION FOLDER`` writes FOLDER/trend; it gives way to everything else.
A session has no event for each step; when the chamber was given which temperature follows from the plan and the events:
a set-point lies between what is recorded in front of it and behind it, as far from the former as the plan says.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.frame import BENCH, LinkDecoder
from bench.model.clock import NS, to_ns
from bench.model.errors import BenchError
from bench.model.events import Answer, End, Event, Phase, Prompt, Reading, Record, Release, Resume, Slip, event_of
from bench.model.posix import give_way
from bench.plan import Step, steps_of
from bench.record import FOLDER, BenchRows, LinkReduction, Message, SessionReader, TrendWriter, layout, sources_of
from bench.replay.described import frames_of, session_signals

NICE = 10
BLOCK_BYTES = 2_000_000


@dataclass(frozen=True)
class SetPoint:
    """Air temperature that is asked from a time on; monotonic time of its part of the session."""

    part: int
    t_ns: int
    value_degC: float


def recorded_setpoints(steps: Sequence[Step], events: Iterable[tuple[int, int, Event]]) -> Iterator[SetPoint]:
    """Yield set-points in order of time, by the compiled plan in the session and its (part, t_mono_ns, event)."""
    asked = {index: step.set_point.temperature_degC for index, step in enumerate(steps) if step.set_point is not None}
    done, known_ns, known_s = 0, 0, 0.0  # steps before ``done`` are over; a time, and what the plan says of it
    started = 0
    for part, t_ns, event in events:
        match event:
            case Resume(start=start):
                done = started = done if start is None else start
                continue
            case Phase(name=name):
                position = max(next((i for i, step in enumerate(steps) if step.phase == name), 0), started)
            case Record() | Slip() | Reading() | Prompt() | Release() | Answer() if 0 <= event.step < len(steps):
                position = event.step
            case End(steps=count) if count >= 0:
                position = min(count, len(steps))
            case _:
                continue
        for index in range(done, position):
            if index in asked:
                after_s = max(0.0, steps[index].at_s - known_s)
                yield SetPoint(part, min(t_ns, known_ns + to_ns(after_s)), asked[index])
        if position < len(steps):
            step, over = steps[position], isinstance(event, Record | Slip)  # written when their step is over
            known_s = step.at_s + (step.duration_s if over else 0.0)
            known_ns = event.t_end_ns if isinstance(event, Record) and event.t_end_ns >= 0 else t_ns
            if over and position in asked and position >= done:
                yield SetPoint(part, known_ns - round(NS * step.duration_s), asked[position])
            done = position + over


@dataclass
class _Begin:
    """The beginning of a part by both clocks; UTC 0 where the session does not say it."""

    t_mono_ns: int = 0
    t_utc_ns: int = 0


def build_trend(folder: Path, out: Path) -> None:
    """Write the trend of a session to ``out``/trend, in one piece; one that is there is replaced.

    Raises: InputError B-REC-010 (no session); SessionDamaged B-REC-012 (no manifest); OSError.
    """
    reader = SessionReader(folder)
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out, prefix=".trend-") as fresh:
        _Building(reader, Path(fresh)).run()
        with suppress(FileNotFoundError):
            shutil.rmtree(out / FOLDER)
        (Path(fresh) / FOLDER).replace(out / FOLDER)


class _Building:
    def __init__(self, reader: SessionReader, out: Path) -> None:
        self._reader, self._out = reader, out
        manifest, texts = reader.manifest, reader.texts
        self._frames = frames_of(manifest, texts)
        self._sources = sources_of(session_signals(manifest, texts), self._frames)
        self._begins, events = _first_look(reader)
        steps = steps_of(texts.get("plan.json", "[]"))
        self._setpoints = list(recorded_setpoints(steps, events))
        self._topics = {f"{layout.LINK}{link}/rx": link for link in self._frames}

    def run(self) -> None:
        """Decode the session part by part."""
        messages = self._reader.select(frozenset({layout.EVENT, *self._topics}))
        for number, begin in enumerate(self._begins):
            mine = [setpoint for setpoint in self._setpoints if setpoint.part == number]
            self._part(TrendWriter(self._out, self._sources, begin.t_mono_ns, begin.t_utc_ns), messages, mine)

    def _part(self, writer: TrendWriter, messages: Iterator[Message], setpoints: list[SetPoint]) -> None:
        """Take messages up to the next ``resume``."""
        links = {
            name: LinkReduction(source, self._frames[name]) for name, source in writer.sources.items() if name != BENCH
        }
        decoders = {name: LinkDecoder(self._frames[name]) for name in links}
        bench, last_ns = BenchRows(), 0
        for message in messages:
            if message.topic == layout.EVENT:
                event = event_of(*message.event())
                if isinstance(event, Resume) and last_ns:
                    break
                while setpoints and setpoints[0].t_ns <= message.t_ns:
                    setpoint = setpoints.pop(0)
                    writer.add(BENCH, bench.setpoint(setpoint.t_ns + writer.offset_ns, setpoint.value_degC))
                writer.add(BENCH, bench.event(event, message.t_ns + writer.offset_ns))
            else:
                decoders[self._topics[message.topic]].push(message.t_ns, message.payload)
                if sum(decoder.pending_bytes for decoder in decoders.values()) > BLOCK_BYTES:
                    self._write(writer, links, decoders)
            last_ns = max(last_ns, message.t_ns)
        self._write(writer, links, decoders)
        writer.add(BENCH, bench.end(last_ns + writer.offset_ns))
        writer.close()

    @staticmethod
    def _write(writer: TrendWriter, links: Mapping[str, LinkReduction], decoders: Mapping[str, LinkDecoder]) -> None:
        for name, link in links.items():
            link.push(decoders[name].flush())
            writer.add(name, link.rows(writer.offset_ns))
        writer.hand_over(writer.take())


def _first_look(reader: SessionReader) -> tuple[list[_Begin], list[tuple[int, int, Event]]]:
    """Return where the parts of a session begin, and its events with the part they belong to."""
    begins: list[_Begin] = [_Begin()]
    events: list[tuple[int, int, Event]] = []
    for message in reader.select(frozenset({layout.EVENT, layout.CLOCK})):
        if message.topic == layout.CLOCK:
            if not begins[-1].t_utc_ns:
                pair: Any = message.document()
                begins[-1] = _Begin(int(pair["t_mono_ns"]), int(pair["t_utc_ns"]))
            continue
        event = event_of(*message.event())
        if isinstance(event, Resume) and events:
            begins.append(_Begin(message.t_ns, 0))
        events.append((len(begins) - 1, message.t_ns, event))
    return begins, events


def main(words: list[str]) -> int:
    """Entry point of the process: exit status of the error, 0 if the trend is there."""
    give_way(NICE)
    try:
        build_trend(Path(words[0]), Path(words[1]))
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return int(error.exit_status)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
