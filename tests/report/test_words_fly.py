"""What is said of a fit that flies outside the tolerances even at its best."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flown_samples import flight, with_offsets

from bayes_aero.diagnosis.trajectories.results import Disagreement
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.report.tables.fly import parameter_table
from bayes_aero.report.text.fly import disagreement_sentences, fly_sentences, outside

DEGREE = np.deg2rad(1.0)


def test_time_outside_is_counted_over_all_manoeuvres():
    """3 deg off for 300 samples of 400, with a tolerance of 2 deg."""
    flown = with_offsets(flight().flown, {"one": 100, "two": 300}, {"one": 1.0 * DEGREE, "two": 3.0 * DEGREE})
    assert outside(flown) == {"alpha": pytest.approx(0.75)}
    (said,) = [line for line in fly_sentences(flown) if "tolerances" in line]
    assert "α 75% of the time" in said
    assert "diagnose" not in said, "it takes models of effects alone, and this one is linear"


def test_nothing_is_said_where_it_stays_inside_most_of_the_time():
    """The same errors, the other way round: a quarter outside."""
    flown = with_offsets(flight().flown, {"one": 100, "two": 300}, {"one": 3.0 * DEGREE, "two": 1.0 * DEGREE})
    assert outside(flown) == {"alpha": pytest.approx(0.25)}
    assert not any("tolerances" in line for line in fly_sentences(flown))


def test_nothing_is_said_of_the_model_where_the_fit_has_not_converged():
    """It may still come nearer."""
    flown = with_offsets(flight().flown, {"one": 100}, {"one": 3.0 * DEGREE})
    assert any("lacks an effect" in line for line in fly_sentences(flown))
    early = replace(flown, fit=replace(flown.fit, status=OutputErrorStatus.NOT_CONVERGED))
    assert not any("lacks an effect" in line for line in fly_sentences(early))


def test_a_fit_under_feedback_alone_is_not_only_called_converged():
    flown = replace(flight().flown, following=("elevator",))
    said = "converged, but feedback and aircraft cannot be parted (elevator)"
    assert said in fly_sentences(flown)[0]
    assert said in parameter_table(flown).terminal_title


def test_nobody_is_sent_to_a_command_that_cannot_use_the_record():
    """A single manoeuvre of some seconds is too short for diagnose."""
    (said,) = disagreement_sentences([Disagreement("CLa", "1/rad", (4.3, 0.1), (3.4, 0.1), 6.4)], "too short")
    assert "diagnose" not in said
    assert "check looks for" in said
