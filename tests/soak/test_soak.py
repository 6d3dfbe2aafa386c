"""Seeded campaigns with mixed faults: the bench is safe at the end, the record valid, every result true or flagged.

Here are some, and what shows that a violation is seen; ``make soak`` soaks any number (tests/soak/run.py).
"""

from __future__ import annotations

from pathlib import Path

import pytest
from soak_campaign import SHORT, Soaked, campaign_of, weigh_estimates

from bench.analysis import Estimate
from bench.run import sequencer

SEEDS = 15
SHORT_INTERVAL_S = 50.0  # between faults: so short that as many faults are drawn as in 24 campaigns of make soak


@pytest.mark.slow
def test_mixed_faults_short(tmp_path: Path) -> None:
    campaign = campaign_of(SHORT, tmp_path, SHORT_INTERVAL_S)
    found = {seed: campaign.soaked(seed, tmp_path / str(seed)).violations for seed in range(SEEDS)}
    assert not any(found.values()), found


def test_a_seed_is_reproduced(tmp_path: Path) -> None:
    campaign = campaign_of(SHORT, tmp_path)
    first, second = (campaign.soaked(3, tmp_path / name) for name in ("a", "b"))
    assert first == second
    assert first.faults
    segments = [sorted((tmp_path / name).rglob("*.mcap")) for name in ("a", "b")]
    assert [path.read_bytes() for path in segments[0]] == [path.read_bytes() for path in segments[1]]


def test_a_bench_that_is_left_on_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequencer, "make_safe", lambda *_, **__: [])
    soaked = campaign_of(SHORT, tmp_path).soaked(0, tmp_path, ())
    assert any("unsafe: supply" in text for text in soaked.violations)
    assert soaked.ended == "done"


def test_a_wrong_number_is_found(tmp_path: Path) -> None:
    campaign = campaign_of(SHORT, tmp_path)
    for channel in campaign.plan.campaign["channels"]:
        channel["k0_C"] *= 1.001
    soaked = campaign.soaked(0, tmp_path, ())
    assert any("sigma off" in text for text in soaked.violations)


@pytest.mark.parametrize(
    ("quality", "value", "std", "violated", "flagged"),
    [
        ("doubtful", 7.0, None, False, 1),  # seeds 20380 and 20393: four of eight records were left
        ("refused", None, None, False, 1),
        ("sound", 7.0, None, True, 1),
        ("sound", None, None, True, 1),
        ("sound", 7.0, 1.0, True, 0),
        ("sound", 2.0, 1.0, False, 0),
    ],
)
def test_an_estimate_without_uncertainty_must_say_that_it_is_not_sound(
    quality: str, value: float | None, std: float | None, violated: bool, flagged: int
) -> None:
    named = {"quantity": "dsf_n", "conditions": {"channel": 1}}
    estimate = Estimate.model_construct(**named, value=value, std_uncertainty=std, quality=quality, dropped=0)
    soaked = Soaked(0, ())
    weigh_estimates([estimate], [{**named, "value": 1.0}], soaked, suspect=False)
    assert (bool(soaked.violations), soaked.flagged) == (violated, flagged)
