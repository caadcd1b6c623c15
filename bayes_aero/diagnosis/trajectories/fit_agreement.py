"""The same parameters from the coefficients and from trajectories: where the two fits of one record disagree."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_aero.diagnosis.trajectories.results import Disagreement, ProcessNoise, TrajectoryFit
from bayes_aero.inference.likelihood.mle_result import MleResult, MleStatus
from bayes_aero.inference.likelihood.restraints import CONFLICT_LIMIT

WORTH = 0.03  # of an estimate, a difference that matters to a simulation; our choice


def still_apart(found: Sequence[Disagreement], fit: ProcessNoise | None) -> tuple[str, ...]:
    """Parameters of `found` of which the fit with process noise disagrees with the coefficients as well."""
    other = {} if fit is None else fit.estimates
    return tuple(d.name for d in found if d.name in other and not _agree(d.coefficients, other[d.name]))


def fit_disagreements(coefficients: MleResult, flown: TrajectoryFit) -> tuple[Disagreement, ...]:
    """Parameters about which the fits differ beyond chance and by more than `WORTH`, the furthest first.

    Those at a bound are left out.
    """
    if coefficients.status not in (MleStatus.CONVERGED, MleStatus.AT_BOUND) or not flown.converged:
        return ()
    fit, found = flown.fit, []
    bound = {*coefficients.at_bound, *fit.at_bound, *fit.held_by_prior}
    one = dict(
        zip(coefficients.names, zip(coefficients.estimate, coefficients.crb_corrected, strict=True), strict=True)
    )
    for parameter, x, sd in zip(fit.parameters, fit.estimate, fit.sd_corrected, strict=True):
        if parameter.name in bound or parameter.name not in one:
            continue
        other, its = one[parameter.name]
        both = float(np.hypot(sd, its))
        pairs = (float(other), float(its)), (float(x), float(sd))
        if np.isfinite(both) and both > 0.0 and not _agree(*pairs):
            apart = float(abs(x - other) / both)
            found.append(Disagreement(parameter.name, parameter.unit, *pairs, apart))
    return tuple(sorted(found, key=lambda d: -d.apart))


def _agree(one: tuple[float, float], other: tuple[float, float]) -> bool:
    """Whether two estimates, each with its standard error, differ by no more than chance or `WORTH`."""
    (x, sd), (y, its) = one, other
    return abs(x - y) <= max(CONFLICT_LIMIT * float(np.hypot(sd, its)), WORTH * max(abs(x), abs(y)))
