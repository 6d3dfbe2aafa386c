"""Manual access to one instrument: same driver, same transcript, a small session of its own."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from bench.model.clock import Clock, utc_stamp
from bench.model.lab import code_texts, recorded_code
from bench.plan import Station
from bench.record import SessionWriter
from bench.run.bus.opener import open_bench
from bench.run.observers import HeldTranscript, Observers, Recorder, new_folder
from bench.run.provenance import lab_of, software


class TalkSession:
    """Opens one instrument, identifies it and records every command and reply; context manager.

    The other instruments are not opened. On leaving, the instrument is left as it is: the person is at the bench.
    """

    def __init__(self, station: Station, role: str, clock: Clock, out: Path) -> None:
        transcript = HeldTranscript()
        self._clock = clock
        self._bench = open_bench(station, clock, transcript, seed=0, links=False, roles=[role])
        self._instrument = self._bench.instruments[role]
        try:
            identity = self._instrument.identify()
        except Exception:
            self._bench.close()
            raise
        name = f"{utc_stamp(clock.utc_ns())}_talk_{role}"
        self.folder = new_folder(out, name)
        manifest = {
            "schema": 1,
            "session": name,
            "simulated": station.simulated,
            "station": station.name,
            "identities": {role: asdict(identity)},
            "standards": station.standards(),
            "software": software(),
            **lab_of(station, roles=[role]),
        }
        texts = {f"stations/{station.name}.yaml": station.document.text, **code_texts(recorded_code(manifest)[0])}
        self._writer = SessionWriter.create(self.folder, manifest, texts, t_mono_ns=clock.now_ns())
        self._writer.clock_pair(clock.now_ns(), clock.utc_ns())
        transcript.attach(Observers(clock, Recorder(self._writer)))

    def send(self, command: str) -> str | None:
        """Send one command; returns the reply of a query."""
        reply: str | None = self._instrument.raw(command)  # type: ignore[attr-defined]
        self._writer.flush()
        return reply

    def __enter__(self) -> TalkSession:
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self._writer.close("talk ended")
        finally:
            self._bench.close()
