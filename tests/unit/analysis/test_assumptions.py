"""What no data can show is named by the system: in results.json as it was said before the run."""

from __future__ import annotations

from bench.analysis import Analysis, build_results, estimate
from bench.model.assumptions import Assumption, assumptions_of

PROVENANCE = {"simulated": True, "plan_sha256": "", "frame_sha256": "", "session_sha256": "", "software": "test"}
GAIN = Assumption("calibrator_gain", "The gain is right.", "Any size.", "One to one.", "A check standard.", ("dsf_n",))


def test_results_name_what_the_campaign_takes_for_granted() -> None:
    analysis = Analysis("test", "gls", {"model": "U", "serial": "1"}, [estimate("dsf_n", "ppm", 1.0, 0.1, {}, n=1)])
    document = build_results("s", analysis, {}, PROVENANCE, assumptions=[GAIN])
    assert document["assumptions"] == [
        {
            "code": "calibrator_gain",
            "taken_for_granted": "The gain is right.",
            "unseen": "Any size.",
            "effect": "One to one.",
            "shown_by": "A check standard.",
            "quantities": ["dsf_n"],
        }
    ]


def test_a_campaign_that_only_records_takes_nothing_for_granted() -> None:
    assert assumptions_of({}) == assumptions_of({"analysis": "none"}) == []
