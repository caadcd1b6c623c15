"""Lags of the separation point that a simulation cannot carry."""

from __future__ import annotations

from bayes_aero.effect import WINGS, Stage
from bayes_aero.errors import InputError
from bayes_aero.model.model import Model
from bayes_aero.parameter import Role


def refuse_lags(model: Model) -> None:
    """Refuse a lag without a time constant, and one of two wings: simulations carry one state of the separation point.

    Raises:
        InputError: the model has such a lag.
    """
    lags = [effect for effect in model.acting if effect.stage is Stage.LAG]
    for effect in lags:
        if not any(p.role is Role.LAG for p in effect.parameters):
            raise InputError(
                f"effect {effect.name} is a lag of the separation point that cannot be flown: none of its parameters "
                "has the role lag"
            )
    if lags and model.two_wings:
        apart = [e.name for e in model.acting if WINGS[0] in e.example.increments]
        raise InputError(
            f"effects {', '.join(apart)} give either wing a separation point, and {lags[0].name} lets it lag: "
            "simulations carry one such state, not two; remove the one or the other"
        )
