"""Lags of the separation point that a simulation cannot follow."""

from __future__ import annotations

from bayes_aero.effect import Stage
from bayes_aero.errors import InputError
from bayes_aero.model.model import Model
from bayes_aero.parameter import Role


def refuse_lags(model: Model) -> None:
    """Refuse a lag without a time constant.

    Raises:
        InputError: the model has such a lag.
    """
    for effect in model.acting:
        if effect.stage is Stage.LAG and not any(p.role is Role.LAG for p in effect.parameters):
            raise InputError(
                f"effect {effect.name} is a lag of the separation point that cannot be flown: none of its parameters "
                "has the role lag"
            )
