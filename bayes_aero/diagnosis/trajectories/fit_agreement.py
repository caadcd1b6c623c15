"""The same parameters from the coefficients and from trajectories: where the two fits of one record disagree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_aero.diagnosis.trajectories.trajectory_fit import TrajectoryFit
from bayes_aero.inference.likelihood.mle_result import MleResult, MleStatus
from bayes_aero.inference.likelihood.restraints import AGAINST

WORTH = 0.03  # of an estimate, a difference that matters to a simulation; our choice


@dataclass(frozen=True)
class Disagreement:
    """One parameter: estimate and standard error by either fit, `apart` combined standard errors, SI."""

    name: str
    unit: str
    coefficients: tuple[float, float]
    trajectories: tuple[float, float]
    apart: float


def fit_disagreements(coefficients: MleResult, flown: TrajectoryFit) -> tuple[Disagreement, ...]:
    """Parameters about which the fits differ beyond chance and by more than `WORTH`, the furthest first.

    Those at a bound are left out.
    """
    if coefficients.status not in (MleStatus.CONVERGED, MleStatus.AT_BOUND) or not flown.converged:
        return ()
    fit, found = flown.fit, []
    bound = {*coefficients.at_bound, *fit.at_bound, *fit.held}
    one = dict(
        zip(coefficients.names, zip(coefficients.estimate, coefficients.crb_corrected, strict=True), strict=True)
    )
    for parameter, x, sd in zip(fit.parameters, fit.estimate, fit.sd_corrected, strict=True):
        if parameter.name in bound or parameter.name not in one:
            continue
        other, its = one[parameter.name]
        both = float(np.hypot(sd, its))
        if np.isfinite(both) and both > 0.0 and abs(x - other) > max(AGAINST * both, WORTH * max(abs(x), abs(other))):
            apart = float(abs(x - other) / both)
            pairs = (float(other), float(its)), (float(x), float(sd))
            found.append(Disagreement(parameter.name, parameter.unit, *pairs, apart))
    return tuple(sorted(found, key=lambda d: -d.apart))
