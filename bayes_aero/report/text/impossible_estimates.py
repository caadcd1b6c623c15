"""Impossible estimates: of the wrong sign (a channel with a reversed sign fits as well as the right one) or size."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from bayes_aero.parameter import Parameter

SURE = 3.0  # standard errors from zero


def sign_sentences(estimates: Mapping[str, tuple[float, float]], parameters: Iterable[Parameter]) -> list[str]:
    """A sentence for every estimate that no aircraft has.

    Args:
        estimates: value and standard error by name, in SI.
        parameters: what the effects declare of their sign and limits.
    """
    asked = [(p, *estimates[p.name]) for p in parameters if p.name in estimates]
    wrong = [
        f"{p.name} = {value:+.4g} has the wrong sign: {p.sign.otherwise}. If the sign of {p.sign.channel} is reversed "
        f"in the file, "
        "write sign = -1 at that channel on the card."
        for p, value, deviation in asked
        if p.sign is not None and p.sign.side * value < -SURE * deviation
    ]
    return wrong + [
        f"{p.name} = {value:.4g} is impossible: {p.limits.reason}. Do not use these numbers. Look for a faulty channel "
        "(bayes-aero check), or for a record that is too short or contains too little excitation."
        for p, value, deviation in asked
        if p.limits is not None
        and (_beyond(p.limits.low, value, deviation, -1.0) or _beyond(p.limits.high, value, deviation, 1.0))
    ]


def _beyond(limit: float, value: float, deviation: float, side: float) -> bool:
    """Whether a value lies beyond the limit on that side, surely or by more than twice the limit."""
    margin = SURE * deviation if math.isfinite(deviation) else 0.0
    return bool(side * (value - limit) > (min(margin, 2.0 * abs(limit)) if limit else margin))
