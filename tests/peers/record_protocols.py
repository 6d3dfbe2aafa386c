"""A pytest plugin for checkouts of PyMeasure and InstrumentKit: records the exchanges that their own tests expect.

``$BENCH_PROTOCOLS`` names the JSON file: ``[[driver, [[message, reply or null], ...]], ...]``, in the order of the
tests. The plugin knows nothing of our package: it runs under the Python of the other project.
"""

import contextlib
import json
import os
from pathlib import Path

recorded = []


def _text(part):
    return part.decode("latin-1") if isinstance(part, bytes | bytearray) else part


def _of_pymeasure():
    import pymeasure.test as theirs

    expected = theirs.expected_protocol

    def recording(instrument_cls, comm_pairs, *arguments, **options):
        pairs = [[_text(message), _text(reply)] for message, reply in comm_pairs]
        recorded.append([instrument_cls.__name__, [[m, None if r is None else str(r)] for m, r in pairs]])
        return expected(instrument_cls, comm_pairs, *arguments, **options)

    theirs.expected_protocol = recording


def _of_instrumentkit():
    import tests as theirs

    expected = theirs.expected_protocol

    def parts(given, sep):
        given = [given] if not isinstance(given, list) else given
        return [part for text in given for part in _text(text).strip(sep).split(sep)]

    @contextlib.contextmanager
    def recording(ins_class, host_to_ins, ins_to_host, sep="\n", repeat=1):
        messages, replies = parts(host_to_ins, sep), iter(parts(ins_to_host, sep))
        pairs = [[message, next(replies, None) if "?" in message else None] for message in messages if message]
        recorded.append([ins_class.__name__, pairs])
        with expected(ins_class, host_to_ins, ins_to_host, sep, repeat) as instrument:
            yield instrument

    theirs.expected_protocol = recording


for project in (_of_pymeasure, _of_instrumentkit):
    with contextlib.suppress(ImportError, AttributeError):
        project()


def pytest_sessionfinish():
    Path(os.environ["BENCH_PROTOCOLS"]).write_text(json.dumps(recorded), encoding="utf-8")
