"""How far the published way of forming coefficients moves their parameters.

As published, pitch acceleration and the other measured signals are smoothed, and the controls that the model answers to
are not: what moves fast is then smaller in the measured coefficient than in the modelled one. Filtering what is left
between the two treats both alike, as `responses` does.
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
BEYOND = 2.0  # corrected deviations, from which a move is worth a word
SHOWN = 4


def filtered_alike(
    records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult
) -> Float[np.ndarray, " k"] | None:
    """Estimates (order of `mle.names`) with both sides filtered alike; None where maximum likelihood has failed."""
    if mle.status not in (MleStatus.CONVERGED, MleStatus.AT_BOUND):
        return None
    responses, theta = Responses(join(records, card), model), mle.estimate.copy()
    free = np.array([name not in mle.at_bound for name in mle.names])
    low, high = np.array([p.bounds for p in model.free]).T
    for _ in range(STEPS):
        residual, S = responses.linearise(theta)
        residual, S = residual[:, : len(NAMES)], S[:, : len(NAMES), free]
        information = np.einsum("mci,c,mcj->ij", S, 1.0 / mle.R, S, optimize=True)
        right = np.einsum("mci,c,mc->i", S, 1.0 / mle.R, residual, optimize=True)
        theta[free] = np.clip(theta[free] + solve(information, right, 0.0), low[free], high[free])
    return theta if np.isfinite(theta).all() else None


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
        f"answers to are not, so what moves fast comes out too small. With both sides filtered alike {told}{more}. "
        "No interval here allows for that; `diagnose` and `fly` treat both sides alike.",
    )
