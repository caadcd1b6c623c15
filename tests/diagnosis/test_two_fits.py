"""Coefficients and trajectories of the same record: told where they differ beyond what both intervals allow."""

from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from bayes_aero.diagnosis.trajectories.fit_agreement import fit_disagreements, still_apart
from bayes_aero.diagnosis.trajectories.results import ProcessNoise, TrajectoryFit
from bayes_aero.inference.likelihood.mle_result import MleResult, MleStatus
from bayes_aero.report.text.fly import disagreement_sentences
from bayes_aero.report.text.process_noise import settled_sentences


def fits(status=MleStatus.CONVERGED, converged=True, at_bound=(), held=()):
    """Of the HFB-320: CLa differs, Cmq not so much; CD0 is in one of them alone."""
    parameters = [SimpleNamespace(name=name, unit=unit) for name, unit in (("CLa", "1/rad"), ("Cmq", "1/rad"))]
    one = Mock(
        spec=MleResult,
        status=status,
        names=("CLa", "Cmq", "CD0"),
        estimate=np.array([4.34, -35.2, 0.03]),
        crb_corrected=np.array([0.14, 3.0, 0.001]),
        at_bound=(),
    )
    fit = SimpleNamespace(
        parameters=parameters,
        estimate=np.array([3.37, -25.3]),
        sd_corrected=np.array([0.15, 2.0]),
        at_bound=at_bound,
        held_by_prior=held,
    )
    return one, Mock(spec=TrajectoryFit, fit=fit, converged=converged)


def test_what_differs_beyond_both_intervals_is_told():
    (found,) = fit_disagreements(*fits())
    assert (found.name, found.coefficients, found.trajectories) == ("CLa", (4.34, 0.14), (3.37, 0.15))
    assert found.apart == pytest.approx(0.97 / np.hypot(0.14, 0.15))
    (said,) = disagreement_sentences([found])
    assert "CLa 4.34 ± 0.14 from the coefficients, 3.37 ± 0.15 from trajectories" in said
    assert "4.7 combined standard errors apart" in said


@pytest.mark.parametrize(
    "unusable",
    [{"status": MleStatus.NOT_CONVERGED}, {"converged": False}, {"at_bound": ("CLa",)}, {"held": ("CLa",)}],
)
def test_what_cannot_be_compared_is_not(unusable):
    assert fit_disagreements(*fits(**unusable)) == ()
    assert disagreement_sentences(()) == []


def with_process_noise(CLa: tuple[float, float], *, converged: bool = True) -> Mock:
    return Mock(spec=ProcessNoise, estimates={"CLa": CLa}, converged=converged, preferred=converged)


@pytest.mark.parametrize(
    ("CLa", "apart", "said"),
    [
        ((4.33, 0.05), (), "CLa agrees with the coefficients (CLa 4.330 ± 0.050): prefer them"),
        ((3.4, 0.05), ("CLa",), "CLa still differs from the coefficients (CLa 3.400 ± 0.050): the model lacks"),
    ],
)
def test_the_filter_decides_between_two_fits_that_disagree(CLa, apart, said):
    disagree, filtered = fit_disagreements(*fits()), with_process_noise(CLa)
    assert still_apart(disagree, filtered) == apart
    (told,) = settled_sentences(disagree, filtered, apart, asked=True)
    assert said in told
    assert told.startswith("The coefficients and output error disagree on CLa.")
    (short,) = settled_sentences(disagree, filtered, apart, asked=False)
    assert said in short
    assert "no-process-noise" not in short


def test_a_filter_that_failed_decides_nothing():
    disagree, failed = fit_disagreements(*fits()), with_process_noise((4.33, 0.05), converged=False)
    assert settled_sentences(disagree, failed, (), asked=False) == []
    assert settled_sentences((), failed, (), asked=True) == []
