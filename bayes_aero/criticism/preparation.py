"""How far the published way of forming coefficients moves their parameters.

As published, pitch acceleration and the other measured signals are smoothed, and the controls that the model answers to
are not: what moves fast is then smaller in the measured coefficient than in the modelled one. Filtering what is left
between the two treats both alike, as `responses` does, which also takes the fast part of alpha-dot from gyro and
accelerometer.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from bayes_aero.criticism.responses import Responses
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import MleResult, MleStatus, solve
from bayes_aero.model.flights import join
from bayes_aero.model.model import Model
from bayes_aero.physics.coefficients import NAMES

STEPS = 3  # of Gauss-Newton: the estimates are near
SETTLED = 0.2  # corrected deviations: a last step that is longer has not ended at the optimum
BEYOND = 2.0  # corrected deviations, from which a move is worth a word
SHOWN = 4


def filtered_alike(
    records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult
) -> Float[np.ndarray, " k"] | None:
    """Estimates (order and units of `mle.names`) with both sides filtered alike, weighed by `mle.R`.

    None where maximum likelihood has failed, or where these steps have not ended at an optimum.
    """
    if mle.status not in (MleStatus.CONVERGED, MleStatus.AT_BOUND):
        return None
    responses, theta = Responses.of(join(records, card), model), mle.estimate.copy()
    free = np.array([name not in mle.at_bound for name in mle.names])
    low, high = np.array([p.bounds for p in model.free]).T
    step = np.zeros(int(free.sum()))
    for _ in range(STEPS):
        residual, S = responses.linearise(theta)
        residual, S = residual[:, : len(NAMES)], np.where(np.isfinite(S), S, 0.0)[:, : len(NAMES), free]
        information = np.einsum("mci,c,mcj->ij", S, 1.0 / mle.R, S, optimize=True)
        right = np.einsum("mci,c,mc->i", S, 1.0 / mle.R, residual, optimize=True)
        if not (np.isfinite(information).all() and np.isfinite(right).all()):
            return None
        step = solve(information, right, 0.0)
        theta[free] = np.clip(theta[free] + step, low[free], high[free])
    return theta if np.all(np.abs(step) <= SETTLED * mle.crb_corrected[free]) else None


def preparation_notes(records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult) -> tuple[str, ...]:
    """A sentence where estimates move by more than their intervals allow for; none where they do not."""
    alike = filtered_alike(records, card, model, mle)
    if alike is None:
        return ()
    sd = mle.crb_corrected
    away = np.abs(alike - mle.estimate) / np.where(sd > 0.0, sd, np.inf)
    far = [i for i in np.argsort(-away) if away[i] > BEYOND]
    if not far:
        return ()
    told = "; ".join(
        f"{mle.names[i]} would be {alike[i]:.4g} {mle.units[i] if mle.units[i] != '1' else ''}".rstrip()
        + f" instead of {mle.estimate[i]:.4g} ({away[i]:.1f} corrected deviations)"
        for i in far[:SHOWN]
    )
    more = f", and {len(far) - SHOWN} more move" if len(far) > SHOWN else ""
    return (
        "Coefficients are formed as published: measured accelerations are smoothed, the controls that the model "
        "answers to are not, and alpha-dot is the vane's. With both sides filtered alike, and the fast part of "
        f"alpha-dot from gyro and accelerometer, {told}{more}. No interval here allows for that; diagnose and fly "
        "treat both sides alike.",
    )
