"""What a raw capture says about its own frames: sync bytes, lengths, check; for the author of a definition.

A hypothesis counts by the bytes of the capture that lie in frames of which the next one begins where the last one ends.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from math import log10
from typing import Literal

import numpy as np

from bench.frame.crc import CATALOGUE, CHECKSUMS, Check, Crc
from bench.model.arrays import Integers, Octets

LOOKED_AT_BYTES = 1 << 20
_PAIRS, _FEWEST = 24, 5  # pairs of bytes that are tried as sync bytes; frames that a hypothesis needs
_LENGTH_PLACES = 8  # bytes behind the sync bytes among which a length field is looked for
_STARTS = 12  # first bytes of a frame at which the check may begin to cover
_TRAILERS = 3
_TRIED = 12  # frames on which every check is tried
_LONGEST = 8192
_ORDERS: tuple[Literal["big", "little"], ...] = ("big", "little")
_LIKELY = 8  # hypotheses of which the check is looked for
_COVERED, _COVERED_WITHOUT_CHECK = 0.2, 0.9  # share of the capture that a hypothesis must explain
_FIRST = 3
_BETWEEN = 128  # bytes of no frame between two frames, at most
_MANY = 200  # frames on which a check is judged
_RIGHT = 0.8
_COVERED_BY_A_BYTE = 0.5  # share that frames must explain whose check is one byte: regular data may fit it
_USUAL = 8  # times the middle length: what is longer explains nothing without a check
LEVEL = -6.0  # log10 of the chance in random bytes, below which a hypothesis is told
_TRIES = 6.0  # log10 of what is tried: sync bytes, places of a length, checks with their places


@dataclass(frozen=True)
class LengthField:
    """Where a frame says its length: bytes from its first one, size in bytes, order; length = value + plus."""

    at: int
    size: int
    big: bool
    plus: int


@dataclass(frozen=True)
class FoundCheck:
    """A check that is right in ``right`` of the frames: its name, place, bytes behind it, first byte covered.

    ``at`` is the place of a check in front of what it covers, None where it stands behind. ``also``: names of others
    that are right as often at the same place: the frames cannot tell them apart.
    """

    name: str
    size: int
    big: bool
    start: int
    trailer: int
    right: int
    at: int | None = None
    also: tuple[str, ...] = ()


@dataclass(frozen=True)
class Guess:
    """One hypothesis: frames begin with ``sync`` at ``starts`` and have ``lengths``; what says so, and the check.

    ``covered``: share of the capture. ``chance``: log10 of the chance of as much in random bytes.
    """

    sync: bytes
    starts: tuple[int, ...]
    lengths: tuple[int, ...]
    length: LengthField | None
    covered: float
    chance: float
    check: FoundCheck | None = None

    @property
    def trailer(self) -> int:
        """Bytes behind the check."""
        return 0 if self.check is None else self.check.trailer

    @property
    def body_at(self) -> int:
        """Where the bytes begin of which nothing is known."""
        ends = [len(self.sync)] + ([self.length.at + self.length.size] if self.length else [])
        if self.check is not None:
            ends.append(self.check.start if self.check.at is None else self.check.at + self.check.size)
        return max(ends)

    @property
    def behind(self) -> int:
        """Bytes behind the fields: check and trailer."""
        return 0 if self.check is None else self.trailer + (self.check.size if self.check.at is None else 0)

    @property
    def has_body(self) -> bool:
        """Whether a frame holds anything but what is known of all."""
        return max(self.lengths) > self.body_at + self.behind

    def frames(self, capture: bytes) -> list[bytes]:
        """Return the frames of the capture."""
        return [capture[at : at + size] for at, size in zip(self.starts, self.lengths, strict=True)]


def guesses(capture: bytes) -> list[Guess]:
    """Return what the frames of a capture may be, the best one first; empty if nothing repeats.

    A hypothesis with a check that is right comes before all without one; then the one that
    explains most of the capture.
    """
    capture = capture[:LOOKED_AT_BYTES]
    found = [guess for sync in _candidates(capture) if (guess := _framed(capture, sync)) is not None]
    found = [guess for guess in found if guess.covered >= _COVERED]
    found = [_with_check(capture, guess) for guess in sorted(found, key=lambda guess: -guess.covered)[:_LIKELY]]
    found = [guess for guess in found if guess.chance <= LEVEL and guess.covered >= _share_due(guess)]
    different = {(guess.sync, guess.starts): guess for guess in found if guess.has_body}.values()
    order = sorted(
        different, key=lambda guess: (guess.check is None, -round(guess.covered, 2), guess.starts[0], guess.trailer)
    )
    return [guess for place, guess in enumerate(order) if not any(_inside(guess, better) for better in order[:place])]


def chance_of(tries: int, hits: int, each: float) -> float:
    """Return log10 of the chance that as many of independent tries hit, and that any hypothesis does; a bound.

    Source: W. Hoeffding, J. Am. Stat. Assoc. 58 (1963) 13, equation (2.1).
    """
    share = hits / max(1, tries)
    if share <= each:
        return 0.0
    missed = (1 - share) * log10((1 - share) / (1 - each)) if share < 1 else 0.0
    return min(0.0, _TRIES - tries * (share * log10(share / each) + missed))


def _share_due(guess: Guess) -> float:
    """Return the share of a capture that frames must explain; without a check, none of unusual length."""
    if guess.check is not None:
        return _COVERED if guess.check.size > 1 else _COVERED_BY_A_BYTE
    lengths = np.array(guess.lengths)
    usual = lengths[lengths <= _USUAL * np.median(lengths)].sum() / lengths.sum()
    return _COVERED_WITHOUT_CHECK / float(usual)


def _inside(guess: Guess, better: Guess) -> bool:
    """Return whether frames begin, most of them, inside those of a better hypothesis: the same, shifted."""
    starts, begins = np.array(guess.starts), np.array(better.starts)
    before = np.searchsorted(begins, starts, side="right") - 1
    ends = begins + np.array(better.lengths)
    inside = (before >= 0) & (starts < ends[before])
    return bool(inside.mean() > _RIGHT)


def checks_that_fit(frames: Sequence[bytes], least_bits: int = 24) -> Iterator[FoundCheck]:
    """Give every known check that is right in four of five frames, wherever it stands; surest first.

    Args: least_bits: bits of checks in all frames together below which nothing is said: it may be chance.
    """
    distinct = _some(frames, _MANY)
    tried = _some(distinct, _TRIED)
    found: list[FoundCheck] = []
    for frame in tried[:_FIRST]:  # the first one may be damaged
        right = (fit for fit in _placements() if _right(fit, [frame]))
        found = found or [fit for fit in right if _right(fit, tried) >= _RIGHT * len(tried)]
    # by chance: one of ten thousand tries is right in a frame with as many bits as the check has
    sure = [replace(fit, right=_right(fit, distinct)) for fit in found if 8 * fit.size * len(tried) >= least_bits]
    sure = [fit for fit in sure if fit.right >= _RIGHT * len(distinct) and _varies(fit, tried)]
    sure.sort(key=lambda fit: (-fit.size * fit.right, fit.at is not None, fit.trailer, fit.start))
    for fit in sure:
        yield replace(
            fit, also=tuple(other.name for other in sure if other != fit and replace(other, name=fit.name) == fit)
        )


def _candidates(capture: bytes) -> list[bytes]:
    """Return the pairs of bytes that occur most often, and the single bytes."""
    stream = np.frombuffer(capture, np.uint8).astype(np.int64)
    if len(stream) < 2:
        return []
    pairs = np.bincount(stream[:-1] << 8 | stream[1:], minlength=65536)
    often = np.argsort(-pairs, kind="stable")[:_PAIRS]
    singles = np.argsort(-np.bincount(stream, minlength=256), kind="stable")[:_PAIRS]
    found = [int(pair).to_bytes(2, "big") for pair in often if pairs[pair] >= _FEWEST]
    return found + [bytes([int(single)]) for single in singles]


def _framed(capture: bytes, sync: bytes) -> Guess | None:
    """Return the lengths under which frames with these sync bytes follow each other best."""
    stream = np.frombuffer(capture, np.uint8)
    ends = len(capture) - len(sync) + 1
    hits = np.ones(ends, np.bool_)
    for index, byte in enumerate(sync):
        hits &= stream[index : index + ends] == byte
    places = np.flatnonzero(hits)
    if len(places) < _FEWEST or len(places) > len(capture) // 4:
        return None
    gap = Counter(np.diff(places).tolist()).most_common(1)[0][0]
    tries: list[tuple[LengthField | None, Integers]] = [(None, np.full(len(places), gap, np.int64))]
    for at in range(len(sync), len(sync) + _LENGTH_PLACES):
        for size, big in ((2, True), (2, False), (1, True)):  # of two that say the same, the wider one
            tries += _length_at(stream, places, at, size, big)
    best: Guess | None = None
    for field, lengths in tries:
        guess = _chained(capture, sync, places, lengths, field)
        if guess is not None and (best is None or guess.covered > best.covered + 1e-9):
            best = guess
    return best


def _length_at(stream: Octets, places: Integers, at: int, size: int,
               big: bool) -> list[tuple[LengthField | None, Integers]]:  # fmt: skip
    """Return the lengths that a field at that place states, with the constant that fits most gaps between frames."""
    if places[-1] + at + size > len(stream):
        places = places[places + at + size <= len(stream)]
    value = np.zeros(len(places), np.int64)
    for index in range(size):
        value = value << 8 | stream[places + at + (index if big else size - 1 - index)]
    if len(places) < _FEWEST or value.min() == value.max():
        return []
    plus, seen = Counter((np.diff(places) - value[:-1]).tolist()).most_common(1)[0]
    if not 0 <= plus <= 64 or seen < _FEWEST:
        return []
    return [(LengthField(at, size, big, plus), value + plus)]


def _chained(capture: bytes, sync: bytes, places: Integers, lengths: Integers,
             field: LengthField | None) -> Guess | None:  # fmt: skip
    """Return the frames whose end is the beginning of another one, or of the whole capture."""
    places = places[: len(lengths)]
    ends = places + lengths
    good = (lengths >= len(sync) + 2) & (lengths <= _LONGEST) & (np.isin(ends, places) | (ends == len(capture)))
    if good.sum() < _FEWEST:
        return None
    starts, sizes = places[good].tolist(), lengths[good].tolist()
    taken: list[int] = []
    free = 0
    for index, (start, size) in enumerate(zip(starts, sizes, strict=True)):
        if start >= free:
            taken.append(index)
            free = start + size
    covered = sum(sizes[index] for index in taken) / len(capture)
    chance = chance_of(len(places), int(good.sum()), len(places) / len(capture))
    return Guess(sync, tuple(starts[i] for i in taken), tuple(sizes[i] for i in taken), field, covered, chance)


def _with_check(capture: bytes, guess: Guess) -> Guess:
    """Return a hypothesis with the check that is right in its frames, and all bytes that these begin with."""
    frames = guess.frames(capture)
    check = next((fit for fit in checks_that_fit(frames) if _apart(guess, fit)), None)
    if check is None and guess.length is None:
        guess = _shorter(guess, frames)
    elif check is not None:
        guess = replace(guess, check=check)
    if (fit := guess.check) is not None:
        chance = chance_of(len(_some(guess.frames(capture), _MANY)), fit.right, 256.0**-fit.size)
        right = [index for index, frame in enumerate(guess.frames(capture)) if _right(fit, [frame])]
        starts, lengths = ([values[index] for index in right] for values in (guess.starts, guess.lengths))
        covered = sum(lengths) / len(capture)
        guess = replace(guess, starts=tuple(starts), lengths=tuple(lengths), covered=covered, chance=chance)
    sync, frames = guess.sync, guess.frames(capture)
    known = [guess.length.at] if guess.length else []
    known += [guess.check.at] if guess.check and guess.check.at is not None else []
    limit = min(4, *known, *(len(frame) - 2 for frame in frames))
    while len(sync) < limit and len({frame[len(sync)] for frame in frames}) == 1:
        sync += frames[0][len(sync) : len(sync) + 1]
    return replace(guess, sync=sync)


def _apart(guess: Guess, fit: FoundCheck) -> bool:
    """Return whether sync bytes, length and check share no byte, and the check covers all of the length or none."""
    field = range(0) if guess.length is None else range(guess.length.at, guess.length.at + guess.length.size)
    held = [] if fit.at is None else range(fit.at, fit.at + fit.size)
    return fit.start not in field[1:] and not set(held) & {*range(len(guess.sync)), *field}


def _shorter(guess: Guess, frames: Sequence[bytes]) -> Guess:
    """Return frames of one length that end with a right check, before bytes that belong to no frame."""
    tried = _some(frames, _TRIED)
    whole = len(tried[0])
    for size in range(whole - _TRAILERS - 1, max(len(guess.sync) + 2, whole - _BETWEEN), -1):
        cut = [frame[:size] for frame in tried]
        for check, start, big in product(_crcs(), range(len(guess.sync) + 1), (True, False)):
            fit = FoundCheck(check.name, check.size, big, start, 0, 1)
            sure = _right(fit, [cut[0], cut[-1]]) and _right(fit, cut) >= _RIGHT * len(cut) and _varies(fit, cut)
            if sure:
                fit = replace(fit, right=_right(fit, [frame[:size] for frame in _some(frames, _MANY)]))
                return replace(guess, lengths=(size,) * len(guess.starts), check=fit)
    return guess


def _some(frames: Sequence[bytes], most: int) -> list[bytes]:
    """Return up to so many different frames from all over a capture."""
    distinct = list(dict.fromkeys(frames))
    return distinct[:: max(1, len(distinct) // most)][:most]


@cache
def _crcs() -> list[Check]:
    return [Crc(model) for model in CATALOGUE.values() if model.width in (16, 24, 32, 64)]


@cache
def _by_name() -> dict[str, Check]:
    small: list[Check] = [Crc(model) for model in CATALOGUE.values() if model.width == 8]
    sums: list[Check] = [check for check in CHECKSUMS.values() if check.size]
    return {check.name: check for check in (*small, *_crcs(), *sums)}


def small_checks(size: int) -> list[Check]:
    """Return the known checks of so many bytes."""
    return [check for check in _by_name().values() if check.size == size]


@cache
def _placements() -> list[FoundCheck]:
    """Return every check wherever it may stand in a frame: behind what it covers, or in front of that."""
    found = []
    for check, big, start in product(_by_name().values(), (True, False), range(_STARTS)):
        fit = FoundCheck(check.name, check.size, big, start, 0, 1)
        if check.size == 1 and not big:
            continue
        found += [replace(fit, trailer=trailer) for trailer in range(_TRAILERS + 1)]
        found += [replace(fit, start=start + check.size, at=start)] if start else []
    return found


def _place(fit: FoundCheck, frame: bytes) -> slice:
    """Return where the check stands in a frame."""
    at = len(frame) - fit.trailer - fit.size if fit.at is None else fit.at
    return slice(at, at + fit.size)


def _varies(fit: FoundCheck, frames: Sequence[bytes]) -> bool:
    """Return whether different frames have different checks: a constant may be right over other constants."""
    return len(frames) == 1 or len({frame[_place(fit, frame)] for frame in frames}) > 1


def _right(fit: FoundCheck, frames: Sequence[bytes]) -> int:
    """Return in how many frames a check is right."""
    check, right = _by_name()[fit.name], 0
    for frame in frames:
        place = _place(fit, frame)
        stop = place.start if fit.at is None else len(frame)
        same = check.of(frame[fit.start : stop]) == int.from_bytes(frame[place], _ORDERS[not fit.big])
        right += fit.start < stop and same
    return right
