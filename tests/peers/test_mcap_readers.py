"""Schemas of exported MCAP files as the open fork of Foxglove reads them, with readers in JavaScript.

They are not part of this project. BENCH_NODE_READERS names a folder where ``npm install @mcap/core @mcap/nodejs
@mcap/support @protobufjs/base64 typescript@5`` was done; BENCH_LICHTBLICK, optional, a checkout of Lichtblick.
"""

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from bench.tables import Session, export_session
from bench.tables.plain import words_of

pytestmark = pytest.mark.peers

READERS, LICHTBLICK = os.environ.get("BENCH_NODE_READERS"), os.environ.get("BENCH_LICHTBLICK")
PROGRAM = Path(__file__).with_name("read_mcap.cjs")
KINDS = {"boolean": "bool", "string": "string", "number": "float64"}  # types of Foxglove by those of JSON


@pytest.fixture(scope="module")
def read(golden: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what the readers give of the exported file, by topic."""
    if READERS is None or shutil.which("node") is None:
        pytest.skip("no readers in JavaScript: set BENCH_NODE_READERS (tests/peers/test_mcap_readers.py)")
    folder = tmp_path_factory.mktemp("mcap") / "out"
    export_session(Session(golden), "mcap", folder)
    (file,) = folder.iterdir()
    schemas = [] if LICHTBLICK is None else [f"{LICHTBLICK}/packages/mcap-support/src/parseJsonSchema.ts"]
    command = ["node", str(PROGRAM), READERS, str(file), *schemas]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def tables_of(session: Session) -> dict[str, pd.DataFrame]:
    tables = {"/events": session.events, "/readings": session.readings, "/records": session.records}
    for link in session.links:
        tables |= {f"/frames/{link}/{name}": session.frames(link, name) for name in session.messages(link)}
    return tables


def test_lichtblick_finds_the_type_of_every_field(read: dict[str, Any], golden: Path) -> None:
    if LICHTBLICK is None:
        pytest.skip("no checkout of Lichtblick: set BENCH_LICHTBLICK")
    for name, table in tables_of(Session(golden)).items():
        types = read[name]["types"]
        assert list(types) == list(words_of(table).values())
        for column, word in words_of(table).items():
            if pd.api.types.is_bool_dtype(table[column].dtype):
                assert types[word] == KINDS["boolean"]
            elif pd.api.types.is_numeric_dtype(table[column].dtype):
                assert types[word] == KINDS["number"], (name, column)
