"""What the engine asks of a system to end the measurement of a point early: the random component of the point's mean.

An analysis declares a module with these functions (``AnalysisDeclaration.point``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

UNTIL = "until"  # word of the decision
STAGE, STAGE_INDEX = "until_stage", "until_index"  # conditions of a record that is one of several of a point
FIRST, SECOND = 1, 2  # stages


class Point(Protocol):
    """Functions of a measuring point. Conditions are those of a record, ``campaign`` as in the manifest.

    ``UNIT``: of its mean, and of the random component where a target is no ratio.
    """

    UNIT: str

    def may_end(self, conditions: Mapping[str, Any]) -> bool:
        """Return whether the point may end early; what others are compared with may not."""

    def level(self, conditions: Mapping[str, Any]) -> float:
        """Return what a target that is a ratio refers to, in ``UNIT``, positive."""

    def random(
        self, campaign: Mapping[str, Any], conditions: Mapping[str, Any], seconds: float, cuts: int
    ) -> tuple[float, float]:
        """Return standard uncertainties of the mean over ``seconds`` in ``cuts`` pieces: by quanta alone, by all.

        Raises: FitError for constants or conditions that do not tell.
        """

    def mean(self, row: Any, campaign: Mapping[str, Any]) -> float:
        """Return the mean of a record (``bench.record.RecordRow``) in ``UNIT``; NaN for one that does not count."""
