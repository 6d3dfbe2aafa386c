"""Quality flags. A flagged reading stays in the record and is counted in the report.

It is left out of fits, with one exception that each analysis states: a record that lost no more frames than the
sequence allows is still a valid mean over the frames that arrived.
"""

from enum import IntFlag


class Quality(IntFlag):
    """Why a reading is not good; 0 is good."""

    GOOD = 0
    LOST = 1  # frames missing inside the record
    BAD_FRAMES = 2  # frames with a failed check inside the record
    OVER_RANGE = 4  # the unit reported an input over range
    NOT_FINITE = 8  # NaN or infinite
    OVERLOAD = 16  # an instrument's overload sentinel
    STALE = 32  # older than its limit
    DUPLICATE = 64  # same counter twice
    SPLICE = 128  # record repeated after a resume
    TRIPPED = 256  # stimulus left its operating state during the dwell
    RETAKEN = 512  # replaced by a later attempt of the same record
    SUSPECT = 1024  # check passed but counter, fixed bits or counts are implausible
    NOT_SETTLED = 2048  # temperature outside its band
