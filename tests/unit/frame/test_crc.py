"""CRC and checksum engines against the published check values and against crccheck."""

import zlib
from functools import reduce
from itertools import accumulate
from operator import xor
from pathlib import Path

import crccheck.crc
import crcmod.crcmod
import numpy as np
import pytest
import yaml

from bench.frame.catalogue import CATALOGUE, CrcModel, find_model
from bench.frame.crc import CHECKSUMS, Crc, find_checksum, require_fast_crc
from bench.model.errors import InputError

CHECK_TEXT = b"123456789"
ORACLES = {kind._names[0].lower(): kind for kind in crccheck.crc.ALLCRCCLASSES if kind._width <= 64}
SEED = 411


def test_the_catalogue_is_that_of_the_oracle_with_its_aliases() -> None:
    assert set(CATALOGUE) == set(ORACLES)
    assert len(CATALOGUE) == 112
    aliases = [(alias, name) for name, kind in ORACLES.items() for alias in kind._names[1:]]
    assert len(aliases) > 60
    for alias, name in aliases:
        model = find_model(alias)
        assert model is not None
        assert model.name == name


@pytest.mark.validates("112 models of CRC", against="the published check values of the CRC catalogue")
@pytest.mark.parametrize("name", CATALOGUE)
def test_published_check_value_single_and_vectorised(name: str) -> None:
    model = CATALOGUE[name]
    crc = Crc(model)
    assert crc.of(CHECK_TEXT) == model.check
    many = np.tile(np.frombuffer(CHECK_TEXT, np.uint8), (200, 1))  # 200 rows: by tables
    assert set(crc.of_rows(many).tolist()) == {model.check}
    assert crc.of_rows(many[:1]).tolist() == [model.check]


@pytest.mark.validates("CRC of random messages, all models", against="the package crccheck")
@pytest.mark.parametrize("name", CATALOGUE)
def test_random_messages_agree_with_the_oracle(name: str) -> None:
    generator = np.random.default_rng(SEED)
    crc = Crc(CATALOGUE[name])
    for length in (1, 2, 7, 53, 94):
        rows = generator.integers(0, 256, (70, length), dtype=np.uint8)
        due = [ORACLES[name].calc(row.tobytes()) for row in rows[:3]]
        assert crc.of_rows(rows)[:3].tolist() == due
        assert [crc.of(row.tobytes()) for row in rows[:3]] == due
        assert crc.of_rows(rows).tolist() == [crc.of(row.tobytes()) for row in rows]


@pytest.mark.parametrize("width", [1, 5, 8, 11, 16, 17, 24, 31, 32, 40, 63, 64])
@pytest.mark.parametrize(("refin", "refout"), [(False, False), (True, True), (False, True), (True, False)])
def test_any_parameters_agree_with_the_oracle(width: int, refin: bool, refout: bool) -> None:
    generator = np.random.default_rng(SEED + width)
    poly, init, xorout = (int(generator.integers(0, 1 << 63)) * 2 + 1 & ((1 << width) - 1) for _ in range(3))
    crc = Crc(CrcModel("custom", width, poly, init, refin, refout, xorout))
    message = generator.integers(0, 256, 61, dtype=np.uint8)
    due = crccheck.crc.Crc(width, poly, init, refin, refout, xorout).calc(message.tobytes())
    assert crc.of(message.tobytes()) == due
    assert crc.of_rows(np.tile(message, (200, 1)))[-1] == due


def test_long_blocks_strided_rows_and_no_rows() -> None:
    generator = np.random.default_rng(SEED)
    frames = generator.integers(0, 256, (9000, 57), dtype=np.uint8)
    crc = Crc(CATALOGUE["crc-32/iso-hdlc"])
    values = crc.of_rows(frames[:, 2:55])
    for row in (0, 4095, 4096, 8191, 8192, 8999):
        assert values[row] == ORACLES["crc-32/iso-hdlc"].calc(frames[row, 2:55].tobytes())
    for few in (frames[:1, 2:55], frames[:2, 2:55]):
        before = few.tobytes()
        assert Crc(CATALOGUE["crc-15/can"]).of_rows(few)[0] == ORACLES["crc-15/can"].calc(few[0].tobytes())
        assert few.tobytes() == before
    assert Crc(CATALOGUE["crc-16/arc"]).of_rows(np.empty((0, 9), np.uint8)).shape == (0,)
    assert Crc(CATALOGUE["crc-15/can"]).of_rows(np.empty((0, 9), np.uint8)).shape == (0,)


PUBLISHED = yaml.safe_load(Path(__file__).with_name("checksums.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("name", "text", "due"), PUBLISHED)
def test_checksums(name: str, text: str, due: int) -> None:
    check, message = find_checksum(name), bytes.fromhex(text)
    assert check is not None
    assert check.of(message) == due
    assert check.of_rows(np.tile(np.frombuffer(message, np.uint8), (3, 1))).tolist() == [due] * 3


def by_loop(name: str, message: bytes) -> int:
    """Return a checksum as its definition tells it, byte by byte or word by word."""
    kind, bits, *how = name.split("-")
    if kind in ("xor", "adler"):
        return reduce(xor, message) if kind == "xor" else zlib.adler32(message)
    word = 2 if how[:1] == ["words"] or (kind, bits) == ("fletcher", "32") else 1
    padded, order = message + bytes(-len(message) % word), "big" if "big" in how else "little"
    words = [int.from_bytes(padded[at : at + word], order) for at in range(0, len(padded), word)]  # type: ignore[arg-type]
    if kind == "fletcher":
        modulus = int(how[0].removeprefix("mod"))
        return sum(accumulate(words)) % modulus << 8 * word | sum(words) % modulus
    return {"ones": ~sum(words), "twos": -sum(words)}.get(how[-1] if how else "", sum(words)) & (1 << int(bits)) - 1


@pytest.mark.parametrize("name", sorted(set(CHECKSUMS) - {"none"}))
def test_checksums_of_one_message_and_of_many_agree(name: str) -> None:
    generator = np.random.default_rng(SEED)
    for length in (1, 2, 255, 2000):
        rows = generator.integers(0, 256, (5, length), dtype=np.uint8)
        rows[0] = 255
        assert CHECKSUMS[name].of_rows(rows).tolist() == [by_loop(name, row.tobytes()) for row in rows]


def test_missing_compiled_part_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    require_fast_crc()
    monkeypatch.setattr(crcmod.crcmod, "_usingExtension", False)
    with pytest.raises(InputError, match="B-FRAME-031"):
        require_fast_crc()
