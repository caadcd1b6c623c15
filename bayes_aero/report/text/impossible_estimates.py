"""Impossible estimates: of the wrong sign (a channel with a reversed sign fits as well as the right one) or size."""

from __future__ import annotations

import math
from collections.abc import Mapping

SURE = 3.0  # standard errors from zero
EXPECTED = {
    "Cmde": (-1.0, "elevator", "a positive deflection (trailing edge down) would pitch the nose up"),
    "CLa": (1.0, "az or alpha", "lift would decrease with the angle of attack"),
}
"""Sign by parameter, the channel to suspect, and what the other sign would mean (axes of ISO 1151)."""
IMPOSSIBLE = {
    "CD0": (0.0, math.inf, "drag without lift cannot be negative"),
    "e": (0.0, 1.5, "no wing has so little induced drag"),
    "CLa": (-math.inf, 4.0 * math.pi, "it is more than twice the value of a thin aerofoil of infinite span, 2 pi"),
    "Cmq": (-math.inf, 0.0, "pitch rate would not be damped"),
}
"""Lowest and highest value by parameter, and why there is none beyond."""


def sign_sentences(estimates: Mapping[str, tuple[float, float]]) -> list[str]:
    """A sentence for every estimate (value, standard error) that is significantly on the wrong side of zero."""
    wrong = [
        f"{name} = {estimates[name][0]:+.4g} has the wrong sign: {meaning}. If the sign of {channel} is reversed "
        f"in the file, "
        "write sign = -1 at that channel on the card."
        for name, (sign, channel, meaning) in EXPECTED.items()
        if name in estimates and sign * estimates[name][0] < -SURE * estimates[name][1]
    ]
    return wrong + [
        f"{name} = {estimates[name][0]:.4g} is impossible: {why}. Do not use these numbers. Look for a faulty channel "
        "(bayes-aero check), or for a record that is too short or contains too little excitation."
        for name, (low, high, why) in IMPOSSIBLE.items()
        if name in estimates and (_beyond(low, *estimates[name], -1.0) or _beyond(high, *estimates[name], 1.0))
    ]


def _beyond(limit: float, value: float, deviation: float, side: float) -> bool:
    """Whether a value lies beyond the limit on that side, surely or by more than twice the limit."""
    margin = SURE * deviation if math.isfinite(deviation) else 0.0
    return bool(side * (value - limit) > (min(margin, 2.0 * abs(limit)) if limit else margin))
