"""What a record cannot test is counted by kind of reason, every effect once."""

import re

from bayes_aero.report.text.phrases import not_testable_sentences

REASONS = {
    "canard_drag": "channel canard was not recorded",
    "canard_lift": "channel canard was not recorded",
    "dlc_lift": "channel dlc_left, dlc_right was not recorded",
    "sideslip_drag": "channel beta does not move in this record",
    "drag_offset": "the model has no e",
    "separation_lag": "a lag is a state of its own, {tried} later",
}


def test_one_sentence_counts_every_effect_once():
    (said,) = not_testable_sentences(REASONS)
    first, *counts = map(int, re.findall(r"(?:^|: |; )(\d+) ", said))
    assert first == sum(counts) == len(REASONS)
    assert counts == [3, 1, 1, 1]
    for name in ("canard, dlc_left and dlc_right", "(beta)", "(e)", "{tried} later"):
        assert name in said
    assert not_testable_sentences({}) == []
