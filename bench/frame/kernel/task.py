"""What one call of the kernel is told and gives back: places in its task, an array of numbers."""

from __future__ import annotations

# of a decoder; what is told, then what is given back, then of each message frames, first one not cut, next one to count
(DEFINITION, LENGTH, POSITION, FINAL, BEFORE, ROOM, BLOCK, BAD, BAD_ROOM, ENDS, STAMPS, CHUNKS, COUNTERS, DECIDED,
 REJECTED, ACCEPTED, LOST, DUPLICATE, SUSPECT, MESSAGES) = range(20)  # fmt: skip
TOLD = DECIDED
GIVEN = MESSAGES - DECIDED
PER_MESSAGE = 3
# of a counter: what is known of it; the line's rate stands there as the bits of a float
(RAW, LAST, HIGHEST, T_NS, REJECTED_RAW, STARTED, WRAP, REACH, PER_NS, MISSED, COUNTER_NUMBERS) = range(11)  # fmt: skip
# what is written of a frame, by message, before the columns of its fields: bytes
OFFSET_BYTES = LENGTH_BYTES = STAMP_BYTES = COUNTER_BYTES = 8
FOUND_BYTES = OFFSET_BYTES + LENGTH_BYTES + STAMP_BYTES + COUNTER_BYTES
# of the encoder; behind them of each field given: its number in the definition, where its column begins in the stage,
# bytes of a number there and whether they have a sign
FRAMES, FRAME_LENGTH, GIVEN_FIELDS, COVERED, OF_GIVEN, GIVEN_NUMBERS = 1, 2, 3, 4, 6, 4
# of quanta; addresses of the noise, int32, and of the clocks, int64; behind them of each row the address of its counts,
# uint16, its sign, size and quantum, and its start, in whose place the rest is given
(NOISE, NOISE_BYTES, CLOCKS, STRETCHES, ROWS, OF_ROWS) = range(6)
(COUNTS, SIGN, SIZE, QUANTUM, START, ROW_NUMBERS) = range(6)
