"""A stranger writes a session with the stock MCAP library, following docs/session-format.md to the letter."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from record_sample import AF_CLOCK, FRAME_NS, NS, constant_stream, frame, housekeeping
from stranger_page import documented_campaign, documented_standards, documented_writer

from bench.analysis import Material, analyse
from bench.model.errors import SessionDamaged
from bench.record import SessionReader
from bench.replay import replay_rows

SECONDS = 10
RECORD_FRAMES = SECONDS * 100
K0_C = 1.25e-6
DSF = {"dsf_n": 412e-6, "dsf_p": -230e-6}
BIAS_A = 3e-8
LEVELS_A = (1e-3, 1e-2, 1e-1)


def manifest() -> dict[str, Any]:
    campaign, standards = documented_campaign("scale_factor"), documented_standards()
    campaign["channels"][0]["levels_A"] = list(LEVELS_A)
    standards["calibrator"]["uncertainty"] = [
        {"range_A": 2.2 * level, "relative": 2e-5, "floor_A": 1e-9} for level in LEVELS_A
    ]
    standards["calibrator"]["corrections"] = []
    return {
        "schema": 1, "session": "stranger", "sequence": "none", "title": "A stranger's session", "simulated": True,
        "links": {"port_a": "frames/ngu_a.yaml", "port_b": "frames/ngu_b.yaml"}, "measurement_link": "port_a",
        "frame_sha256": {"port_a": frame("ngu_a").sha256}, "plan_sha256": "none", "campaign": campaign,
        "planned": {"prepare_s": 0, "duration_s": 0, "records": 9, "steps": 0}, "standards": standards,
    }  # fmt: skip


def points() -> list[dict[str, Any]]:
    """Open input, both zeros, both polarities of each level: conditions of each record."""
    common = {"channel": 1, "kind": "gyro", "temperature_degC": 20.0, "level_index": 0, "repeat": 0}
    open_input = {**common, "current_A": 0.0, "polarity": 0, "range_A": 2.2e-3, "route": "open"}
    steps = [open_input]
    for index, level in enumerate((0.0, *LEVELS_A)):
        point = {**common, "current_A": level, "route": "closed", "level_index": index}
        range_A = 2.2 * (level or LEVELS_A[0])
        steps += [{**point, "polarity": polarity, "range_A": range_A} for polarity in (1, -1)]
    return steps


@cache
def pulses(current_A: float) -> tuple[np.ndarray, np.ndarray]:
    """Pulse counts of each frame of one record, exact to a pulse: (n, 10) each, only channel 1 counts."""
    total = current_A - BIAS_A
    charge = K0_C * (1 + (DSF["dsf_n"] if total > 0 else DSF["dsf_p"]))
    whole = np.floor(np.arange(RECORD_FRAMES + 1) * (abs(total) / 100 / charge) + 0.5)
    counts = np.zeros((RECORD_FRAMES, 10), np.int64)
    counts[:, 0] = np.diff(whole)
    return (counts, np.zeros_like(counts)) if total > 0 else (np.zeros_like(counts), counts)


@cache
def messages() -> tuple[tuple[str, int, bytes], ...]:
    """Frames of the whole campaign in chunks of 0.5 s, housekeeping, record events."""
    sent: list[tuple[str, int, bytes]] = []
    conditions = points()
    pairs = [pulses(step["current_A"] * step["polarity"]) for step in conditions]
    frames = constant_stream(np.concatenate([n for n, _ in pairs]), np.concatenate([p for _, p in pairs])).frames
    for block in range(len(frames) // 50):
        t_ns = (block + 1) * 50 * FRAME_NS
        sent.append(("/link/port_b/rx", t_ns, housekeeping(5, 5 * block)))
        sent.append(("/link/port_a/rx", t_ns, frames[50 * block : 50 * (block + 1)].tobytes()))
        if (block + 1) % (2 * SECONDS) == 0:
            number = (block + 1) // (2 * SECONDS)
            fields = {
                "number": number, "link": "port_a", "first_counter": (number - 1) * RECORD_FRAMES,
                "frames": RECORD_FRAMES, "t_start_ns": t_ns - SECONDS * NS, "t_end_ns": t_ns,
                "conditions": conditions[number - 1], "step": -1,
            }  # fmt: skip
            sent.append(("/event", t_ns, json.dumps({"kind": "record", "fields": fields}).encode()))
    return tuple(sent)


def texts() -> dict[str, str]:
    return {f"frames/{name}.yaml": frame(name).text for name in ("ngu_a", "ngu_b")}


VARIANTS = {
    "lz4": {},
    "plain": {"compression=CompressionType.LZ4": "compression=CompressionType.NONE"},
    "no index": {"CompressionType.LZ4)": "CompressionType.LZ4, index_types=IndexType.NONE)"},
    "no chunks": {"CompressionType.LZ4)": "CompressionType.LZ4, use_chunking=False)"},
    "no CRC": {"CompressionType.LZ4)": "CompressionType.LZ4, enable_crcs=False, chunk_size=10_000_000)"},
    "data CRC": {"CompressionType.LZ4)": "CompressionType.LZ4, enable_data_crcs=True, chunk_size=5_000)"},
}


@pytest.mark.validates(
    "reading a session, six forms of the container",
    against="sessions written by the stock package mcap",
)
@pytest.mark.parametrize("variant", VARIANTS)
def test_a_strangers_session_is_replayed_and_fitted(tmp_path: Path, variant: str) -> None:
    documented_writer(**VARIANTS[variant])(tmp_path, manifest(), texts(), messages())
    done = replay_rows(tmp_path, strict=True)
    assert (done.damage, done.unfinished, done.notes) == ((), (), ())
    assert len(done.rows) == len(points())
    assert done.totals == {"frames": 1.1 * RECORD_FRAMES * len(points()), "frames_bad": 0, "frames_lost": 0}
    for row, step in zip(done.rows, points(), strict=True):
        n, p = pulses(step["current_A"] * step["polarity"])
        assert row.sums["npp"].tolist() == n.sum(axis=0).tolist()
        assert row.sums["ppp"].tolist() == p.sum(axis=0).tolist()
        assert int(row.sums["af_clock"]) == AF_CLOCK * RECORD_FRAMES
        assert row.quality == 0
        assert row.context["unit_temperature_degC"] == pytest.approx(20.035, abs=1e-9)
    analysis = analyse(Material(done.rows, done.manifest["campaign"], done.manifest["standards"]))
    for estimate in analysis.estimates:
        if estimate["quantity"] in DSF:
            error_ppm = estimate["value"] - 1e6 * DSF[estimate["quantity"]]
            assert abs(error_ppm) < estimate["expanded_uncertainty"]
    assert {estimate["quantity"] for estimate in analysis.estimates} >= set(DSF)


def test_the_hash_of_a_session_without_a_chain_covers_its_data(tmp_path: Path) -> None:
    write = documented_writer()
    for name in ("a", "b", "c"):
        (tmp_path / name).mkdir()
        sent = [*messages()[:40]]
        if name == "c":
            sent[7] = (sent[7][0], sent[7][1], sent[7][2][:-1] + b"\0")
        write(tmp_path / name, manifest(), texts(), sent)
    one, same, other = (SessionReader(tmp_path / name).sha256 for name in ("a", "b", "c"))
    assert one == same != other


def test_zstd_is_refused_with_the_reason(tmp_path: Path) -> None:
    edits = {"compression=CompressionType.LZ4": "compression=CompressionType.ZSTD"}
    documented_writer(**edits)(tmp_path, manifest(), texts(), messages()[:10])
    assert "zstd" in SessionReader(tmp_path).damage[0].what


def test_foreign_topics_are_left_alone(tmp_path: Path) -> None:
    extra = 'writer.register_channel("/camera", "jpeg", schema_id=0)'
    edits = {"        writer.finish()": f"        writer.add_message({extra}, 1, b'any', 1)\n        writer.finish()"}
    documented_writer(**edits)(tmp_path, manifest(), texts(), messages()[:10])
    reader = SessionReader(tmp_path)
    assert reader.damage == []
    assert "/camera" not in reader.counts


def test_data_section_crc_of_a_file_without_a_chain_is_checked(tmp_path: Path) -> None:
    documented_writer(**VARIANTS["data CRC"])(tmp_path, manifest(), texts(), messages()[:40])
    path = tmp_path / "session.0001.mcap"
    content = bytearray(path.read_bytes())
    content[9 + 8 + 4] ^= 1  # inside the profile of the header record
    path.write_bytes(content)
    assert [item.what for item in SessionReader(tmp_path).damage] == ["CRC of the data section is wrong"]


@pytest.mark.parametrize(
    ("topic", "payload"),
    [
        ("/event", b"{"),
        ("/event", b"[1]"),
        ("/event", b'{"kind": "record"}'),
        ("/manifest", b"\xff"),
        ("/text/a", b"\xff"),
    ],
)
def test_content_that_is_not_what_its_topic_promises(tmp_path: Path, topic: str, payload: bytes) -> None:
    sent = [(topic, 0, payload), ("/clock", 0, b"{}")]
    edits = (
        {'head = [("/manifest", start_ns, json.dumps(manifest).encode())]': "head = []"} if topic == "/manifest" else {}
    )
    documented_writer(**edits)(tmp_path, manifest(), texts(), sent)
    with pytest.raises(SessionDamaged, match="B-REC-014"):
        replay_rows(tmp_path)
