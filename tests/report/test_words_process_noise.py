"""What is said of gusts and buffet that a filter has met."""

from __future__ import annotations

import pytest
from flown_samples import flight

from bayes_aero.diagnosis.trajectories.results import ProcessNoise
from bayes_aero.report.text.process_noise import process_noise_sentences

GUSTS = {"vertical_gust": (1.5, 0.1), "vertical_gust_length": (200.0, 30.0),
         "longitudinal_gust": (0.1, 0.2), "longitudinal_gust_length": (300.0, 200.0)}  # fmt: skip


def said(**more):
    met = GUSTS | {"buffet": (0.05, 0.01), "buffet_length": (3.0, 0.5)} | more
    return process_noise_sentences(ProcessNoise("converged", True, 20.0, {}, {}, {}, {}, met), flight().flown)


def test_gusts_and_buffet_are_told_in_their_own_units():
    told = said()
    assert "Estimated gusts, standard deviation: vertical 1.50 ± 0.10 m/s (scale length 200 ± 30 m)." in told
    assert "No longitudinal gusts are distinguishable from noise of the states." in told
    assert (
        "Buffet: the lift coefficient of fully separated flow fluctuates by 0.050 ± 0.010 (standard deviation; "
        "correlated over 3.00 ± 0.50 chords)."
    ) in told


@pytest.mark.parametrize(("intensity", "none"), [((0.02, 0.01), True), ((0.021, 0.01), False)])
def test_an_intensity_within_two_standard_errors_is_none(intensity, none):
    assert ("No buffet is distinguishable from noise of the states." in said(buffet=intensity)) is none
