"""Public wire formats: bytes that other people published, and a capture made by strangers with their decode."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from record_sample import ROOT, captured
from record_sample import frame as frame_of

from bench.frame import LinkDecoder, load_frame, parse_frame

# OEM7 documentation, "ASCII to binary log conversion example", and GPStation-6 manual, page 44: the same check covers
# every binary log, so the vendor's two BESTPOS logs hold the one of INSPVAS
BESTPOS = """
aa44121c2a000020480000005eb40b0780ada301000000004561832500000000200000001011865b5868404009a4cc35038141408f53742497ef33
406666a2413d0000004faf143d645d5c3defc9c33d30000000000040400000000012090900000000 01c3ef64d2
""", """
aa44121c2a0002204800000090b49305b0abb912000000004561bc0a00000000100000001b0450b3f28e494016fa6bbe7c825cc00060769f449f90
40a62a82c13d000000125acb3fcd9e983fdb664040003030300000000000000000 0b0b00000006000342dc4c48
"""  # fmt: skip


def golden(name: str) -> bytes:
    return bytes.fromhex((ROOT / "tests" / "golden" / f"{name}.hex").read_text(encoding="ascii"))


@pytest.mark.validates(
    "frame novatel_inspvas: check and fields",
    against="two logs of the vendor's manuals, and a log of a receiver in the tests of an open driver, with its values",
)
def test_logs_of_novatel(record_property: Callable[[str, object], None]) -> None:
    text = frame_of("novatel_inspvas").text
    check = next(line for line in text.splitlines() if line.startswith("crc:"))
    for published in BESTPOS:
        log = bytes.fromhex("".join(published.split()))
        assert len(log) == 104
        body = f"{{name: body, type: bytes, count: {len(log) - 7}}}"
        other = f"frame: any\nendian: little\nsync: [0xAA, 0x44, 0x12]\nfields: [{body}]\n{check}\n"
        parse_frame(f'{other}golden: "{log.hex()}"\nexpect: {{body: "{log[3:-4].hex()}"}}\n', "any.yaml")
    batch = frame_of("novatel_inspvas").decoder().feed(golden("novatel_inspvas")).messages["frame"]
    # as the other driver prints them, seven to eight digits
    theirs = {"latitude": 40.040837, "longitude": 116.504558, "height": 27.403953, "velocity_north": 0.069381334,
              "velocity_east": 9.647163, "velocity_up": -0.0059339763}  # fmt: skip
    for name, value in theirs.items():
        assert batch.scaled(name)[0] == pytest.approx(value, rel=6e-8), name
    np.testing.assert_allclose(batch.scaled("attitude")[0], [0.59717965, 0.053063083, 90.934232], rtol=6e-8)
    assert batch.scaled("header_time")[0] == batch.scaled("tick")[0] == 197594.6
    record_property("obtained", "checks of 3 published logs right; 9 values equal to all printed digits")


def test_a_message_of_kvh_is_sound() -> None:
    """All six sensors good, 1 g along one axis, the check as the maker's table of the CRC asks for it."""
    batch = frame_of("kvh_1750").decoder().feed(golden("kvh_1750")).messages["frame"]
    assert golden("kvh_1750")[-4:].hex() == "4bfa34d8"
    assert [int(batch.raw(f"status.{kind}_{axis}")[0]) for kind in ("gyro", "accel") for axis in "xyz"] == [1] * 6
    assert np.linalg.norm(batch.scaled("accel")[0]) == pytest.approx(1.0, abs=0.003)


def kvh_rows(count: int) -> np.ndarray:
    place = np.arange(count)
    angle = np.outer(place, [1e-6, -2e-6, 3e-6]).astype(np.float32)
    columns = {"delta_angle": angle, "accel": np.zeros((count, 3), np.float32), "status": 0x77, "temperature": 25}
    return frame_of("kvh_1750").encode(columns | {"counter": place % 128}, count)


def test_the_counter_of_kvh_goes_on_behind_127() -> None:
    rows = kvh_rows(1000)
    link = LinkDecoder(frame_of("kvh_1750"))
    link.push(0, np.delete(rows, [126, 127, 128, 640], axis=0).tobytes())
    batch = link.flush().messages["frame"]
    assert (link.counts.frames, link.counts.lost, link.counts.duplicate, link.counts.suspect) == (996, 4, 0, 0)
    assert batch.counter is not None
    assert batch.counter.tolist() == [place for place in range(1000) if place not in (126, 127, 128, 640)]


@pytest.mark.parametrize(
    "path", sorted((ROOT / "tests" / "golden" / "public").glob("*.yaml")), ids=lambda path: path.stem
)
def test_frames_that_others_published_are_decoded_and_written_again(path: Path) -> None:
    definition = load_frame(path)
    stream = b"\0" + b"".join(definition.golden) * 3
    for engine in ("numpy", "reference"):
        decoder = definition.decoder(engine)  # type: ignore[arg-type]
        batch = decoder.feed(stream)
        assert {name: len(batch.messages[name]) for name in definition.messages} == dict.fromkeys(
            definition.messages, 3
        )
    if definition.name != "mip":  # its other items are not listed
        for name, frame in zip(definition.messages, definition.golden, strict=True):
            message = batch.messages[name]
            values = {field.name: message.raw(field.name)[0] for field in message.message.fields}
            assert definition.encode_one(values, name) == frame


RECORDINGS = Path(os.environ.get("BENCH_REAL_DATA", ROOT.parent / "shared" / "data")) / "vn100"

IS_THERE = pytest.mark.skipif(not (RECORDINGS / "F00379").exists(), reason=f"no recording {RECORDINGS / 'F00379'}")


@pytest.mark.real
@IS_THERE
@pytest.mark.parametrize("engine", ["numpy", "reference"])
def test_counts_of_the_capture(engine: str) -> None:
    decoded, _ = captured(frame_of("vn100_binary"), RECORDINGS / "F00379", engine)  # type: ignore[arg-type]
    assert (decoded.counts.frames, decoded.counts.bad) == (8895, 2)
    assert decoded.counts.bytes == 1_437_495


@pytest.mark.real
@IS_THERE
@pytest.mark.validates(
    "frame decoder on a real capture of 8,895 frames", against="a decode of the same capture by other people's software"
)
def test_all_columns_equal_the_independent_decode_within_its_print_rounding(
    record_property: Callable[[str, object], None],
) -> None:
    _, messages = captured(frame_of("vn100_binary"), RECORDINGS / "F00379")
    batch = messages["frame"]
    names = [item.name for item in batch.message.fields if item.name != "header"]
    ours = np.column_stack([batch.scaled(name) for name in names])
    lines = (RECORDINGS / "F00379_B").read_text(encoding="ascii").splitlines()[1:]
    theirs = np.array([[float(text) for text in line.split(",")[:-1]] for line in lines if line.count(",") == 29])
    assert ours.shape == theirs.shape == (8895, 29)
    # printed as 1.234567e+02: only half a unit of the last printed digit may differ, 5e-5 for values from 100 on
    last_digit = 10.0 ** (np.floor(np.log10(np.maximum(np.abs(theirs), 1e-30))) - 6)
    worst = float(np.max(np.abs(ours - theirs) / last_digit))
    record_property("obtained", f"29 columns, worst {worst:.3f} of the last printed digit, limit 0.5")
    assert (np.abs(ours - theirs) <= 0.5 * last_digit * (1 + 1e-6)).all()
