"""Records numbers into a session as a run does, and says on its standard output what is safely on the disk.

Words: folder, seconds, resume|new. Each second: bytes of a link, a "record" event, a step in the journal; then all of
it is brought to the disk, and only then the second is acknowledged. A disk that refuses is waited for, as in a run.
"""

import sys
from pathlib import Path
from typing import Any

from bench.model.clock import NS
from bench.model.events import Disk, Resume
from bench.record import Journal, SessionWriter
from bench.record.recover import resume_session
from bench.run.observers import patient

MANIFEST = {"schema": 1, "session": "recorded", "links": {"port_a": "frames/ngu_a.yaml"}, "measurement_link": "port_a"}
TEXTS = {"sequences/x.yaml": "sequence: x\n", "plan.json": "[]"}
EACH_S = 400  # of the bench's time in a second of these: a segment is finished each nine seconds


def say(trouble: Disk) -> None:
    print(f"trouble {trouble.text}", flush=True)


def main(folder: str, seconds: str, how: str) -> int:
    place = Path(folder)
    if how == "new":
        writer = SessionWriter.create(place, MANIFEST, TEXTS, t_mono_ns=0)
    else:
        writer = resume_session(place, Resume(reason="killed"), t_mono_ns=0)
    journal = Journal(place)
    tick, sync, step = (patient(call, say) for call in (writer.tick, writer.sync, journal.step))  # type: ignore[arg-type]
    first = number_after(place) if how != "new" else 0
    for number in range(first, first + int(seconds)):
        t_ns = (number - first) * EACH_S * NS
        writer.raw("port_a", "rx", t_ns, number.to_bytes(4, "big"))
        fields: dict[str, Any] = {"number": number}
        writer.event("record", t_ns, fields)
        step(number, "campaign", t_ns, {})
        tick(t_ns)
        sync()
        journal.sync()
        print(f"ack {number}", flush=True)
    writer.close("done")
    journal.close()
    print("closed", flush=True)
    return 0


def number_after(place: Path) -> int:
    """The number behind the last one that the session holds."""
    from bench.record import SessionReader

    return max((int(fields["number"]) for _, _, fields in SessionReader(place).events("record")), default=-1) + 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
