"""The covariance of a fitted model's estimates, with what a diagnosis adds to it for its causes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.result import Cause
from bayes_aero.diagnosis.screening.autocorrelation import autocorrelation_of
from bayes_aero.diagnosis.screening.regression import Fit
from bayes_aero.diagnosis.screening.screening import uncertainty
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.view.results import JointCovariance


def covariance_of(state: SelectionState, fit: Fit) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """Which parameters were fitted, and the covariance of their estimates that coloured residuals leave."""
    own = np.flatnonzero(fit.columns < len(state.theta))
    covariance = uncertainty(state, fit, autocorrelation_of(state.left(fit), state.folds))
    return fit.columns[own], covariance[np.ix_(own, own)]


def joint_covariance(
    state: SelectionState, fit: Fit, deviations: Mapping[str, float], causes: Sequence[Cause]
) -> JointCovariance:
    """Of all parameters of the extended model, as its standard errors are reported.

    A parameter may be reported with a larger error than coloured residuals leave: noise of the recorded regressors and
    the scatter between stretches count, too. What is beyond is independent of the other parameters.

    Args:
        state: the extended model at its optimum.
        fit: there.
        deviations: reported standard errors of the card's parameters, SI.
        causes: those of the diagnosis, with the reported standard errors of their parameters.
    """
    columns, covariance = covariance_of(state, fit)
    names = tuple(state.full.model.names[c] for c in columns)
    reported = dict(deviations) | {name: size.sd for cause in causes for name, size in cause.parameters.items()}
    variance = np.diag(covariance)
    beyond = [max(reported.get(name, 0.0) ** 2 - own, 0.0) for name, own in zip(names, variance, strict=True)]
    return JointCovariance(names, 0.5 * (covariance + covariance.T) + np.diag(beyond))  # symmetric but for rounding
