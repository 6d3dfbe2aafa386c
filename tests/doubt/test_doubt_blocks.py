"""How wrong worlds are counted: what must not be is found, and the tables are of the rows."""

from dataclasses import replace
from typing import Any

from doubt_blocks import Block, all_worlds, done_block, module_of
from doubt_classes import Seen, worst_bias
from doubt_page import faults_of

from bench.analysis import Estimate

WRONG = Block("north", "magnet", 0.1, 0, 9, "0123abc", 25.0, 3.2, 7, 0, 1, 0, 0, 2, 2, 0, 1.5)
RIGHT = Block("north", "", 0.0, 0, 499, "0123abc", 0.0, 0.0, 490, 0, 10, 0, 0, 0, 0, 5, 60.0)


def test_what_could_have_been_seen_and_was_not_is_a_fault() -> None:
    (fault,) = faults_of([WRONG], {"magnet": "once_per_turn"})
    assert fault == "north, magnet 0.1: 2 confidently wrong, and it could have been seen"
    assert faults_of([replace(WRONG, confidently_wrong=0, visible=0)], {}) == []


def test_what_is_hidden_needs_a_name() -> None:
    hidden = replace(WRONG, visible=0)
    assert faults_of([hidden], {"magnet": "once_per_turn"}) == []
    assert faults_of([hidden], {"magnet": ""}) == ["north, magnet 0.1: 2 confidently wrong, and no assumption names it"]


def test_right_worlds_are_doubted_once_in_a_hundred_at_most() -> None:
    assert faults_of([RIGHT], {}) == []
    assert faults_of([replace(RIGHT, last=249, campaigns=2), replace(RIGHT, first=250, campaigns=4)], {}) == [
        "north: 6 of 500 right campaigns are doubted"
    ]


def test_a_bias_is_in_the_uncertainty_of_the_right_world() -> None:
    def entry(value: float | None, expanded: float | None) -> Any:
        named = {"quantity": "dsf_n", "conditions": {"channel": 1}}
        return Estimate.model_construct(**named, value=value, expanded_uncertainty=expanded)

    right = Seen([entry(10.0, 2.0)], [10.0], 0.0, 1)
    assert worst_bias(Seen([entry(13.0, None)], [10.0], 0.0, 1), right) == {"dsf_n": 1.5}
    assert worst_bias(Seen([entry(None, None)], [10.0], 0.0, 1), right) == {}


def test_a_block_counts_every_estimate_that_the_campaign_promises() -> None:
    worlds = next(one for one in all_worlds() if one.SYSTEM == "scale_factor")
    block, biases = done_block(module_of(worlds), "soft_saturation", 1e-3, range(3, 4), "0123abc")
    promised = worlds.seen(3, None, 0.0).promised
    assert block.right + block.wide + block.missed + block.doubted + block.refused == promised
    assert block.doubted > 0
    assert block.campaigns == 1
    assert block.trace > 100.0
    assert max(bias.worst for bias in biases) == block.bias > 10.0
