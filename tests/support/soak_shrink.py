"""From a campaign that violates an invariant to the few faults that are needed for it, and a test of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

from fault_schedule import TimedFault
from soak_campaign import SHORT

FOUND = Path(__file__).resolve().parents[1] / "soak"

_TEST = '''"""Found by ``make soak`` at revision {revision}: {drawn} faults were drawn, {needed} are needed.

{violations}
"""

from __future__ import annotations

from pathlib import Path

import pytest
from fault_schedule import TimedFault
from soak_campaign import campaign_of

FAULTS = {faults}


@pytest.mark.{mark}
def test_{campaign}_{seed}(tmp_path: Path) -> None:
    assert campaign_of("{campaign}", tmp_path).soaked({seed}, tmp_path, FAULTS).violations == []
'''


def shortest(faults: Sequence[TimedFault], fails: Callable[[Sequence[TimedFault]], bool]) -> list[TimedFault]:
    """Return a part of a list that fails and does no longer when any one of its faults is left out.

    Ever smaller pieces are left out, single ones until a round changes nothing. The whole list must fail: it is not
    tried again. Source: A. Zeller, R. Hildebrandt, IEEE Trans. Software Eng. 28(2), 183-200 (2002), simplified.
    """
    kept = list(faults)
    size = len(kept)
    while size:
        at, before = 0, len(kept)
        while at < len(kept):
            rest = kept[:at] + kept[at + size :]
            if fails(rest):
                kept = rest
            else:
                at += size
        size = size // 2 if size > 1 or len(kept) == before else 1
    return kept


def written_test(
    campaign: str, seed: int, faults: Sequence[TimedFault], drawn: int, violations: Sequence[str], revision: str
) -> str:
    """Return the text of a test that fails as long as these faults violate an invariant."""
    lines = "".join(f"    {_expression(fault)},\n" for fault in faults)
    return _TEST.format(
        revision=revision, drawn=drawn, needed=len(faults), campaign=campaign, seed=seed,
        violations="\n".join(text[:110] for text in violations).replace("\\", "/").replace('"""', "'''"),
        faults=f"[\n{lines}]" if faults else "list[TimedFault]()",
        mark="slow" if campaign == SHORT else "sweep",
    )  # fmt: skip


def _expression(fault: TimedFault) -> str:
    values = "".join(f"{json.dumps(value)}, " for value in fault.values)
    values = values.removesuffix(" " if len(fault.values) == 1 else ", ")
    return f'TimedFault({fault.at_s!r}, "{fault.name}", "{fault.target}", ({values}), {fault.for_s!r})'


def write_test(campaign: str, seed: int, text: str, folder: Path = FOUND) -> Path:
    """Write the test where pytest collects it."""
    path = folder / f"test_found_{campaign}_{seed}.py"
    path.write_text(text, encoding="utf-8")
    return path
