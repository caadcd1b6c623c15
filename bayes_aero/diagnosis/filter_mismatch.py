"""How far the published way of forming coefficients moves their parameters.

As published, pitch acceleration and the other measured signals are smoothed, and the controls that the model answers
to are not: what moves fast is then smaller in the measured coefficient than in the modelled one. With every signal
filtered alike both sides are treated alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.results import MleResult, MleStatus
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Forming, observe

BEYOND = 2.0  # corrected deviations, from which a move is worth a word
SHOWN = 4


def filter_mismatch_notes(records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult) -> tuple[str, ...]:
    """A sentence where estimates of `mle`, the fit to coefficients formed as published, move by more than their
    intervals allow for once all signals are filtered alike; none where they do not, or where either fit has failed."""
    sound = (MleStatus.CONVERGED, MleStatus.AT_BOUND)
    if mle.status not in sound:
        return ()
    alike = fit_mle(model, observe(records, card, model, Forming.MATCHED), start=mle.estimate, extra_starts=0)
    if alike.status not in sound:
        return ()
    sd = mle.crb_corrected
    away = np.abs(alike.estimate - mle.estimate) / np.where(sd > 0.0, sd, np.inf)
    far = [i for i in np.argsort(-away) if away[i] > BEYOND]
    if not far:
        return ()
    told = "; ".join(
        f"{mle.names[i]} would be {alike.estimate[i]:.4g} {mle.units[i] if mle.units[i] != '1' else ''}".rstrip()
        + f" instead of {mle.estimate[i]:.4g} ({away[i]:.1f} corrected standard errors)"
        for i in far[:SHOWN]
    )
    more = f", and {len(far) - SHOWN} more move" if len(far) > SHOWN else ""
    return (
        "Coefficients are formed as published: measured accelerations are smoothed, control inputs of the model are "
        f"not, and alpha-dot is the derivative of the vane angle. With the same filter on all signals, "
        f"{told}{more}. No "
        "interval here includes this difference; without --coefficients published both sides are filtered alike.",
    )
