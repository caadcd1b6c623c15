"""Estimates whose sign no aircraft has: a channel that the file counts the other way fits as well as the right one."""

from __future__ import annotations

from collections.abc import Mapping

SURE = 3.0  # deviations from zero
EXPECTED = {
    "Cmde": (-1.0, "elevator", "trailing edge down, which counts as positive, would raise the nose"),
    "CLa": (1.0, "az or alpha", "lift would fall as the angle of attack grows"),
}
"""Sign by parameter, the channel to suspect, and what the other sign would mean (axes of ISO 1151)."""


def sign_sentences(estimates: Mapping[str, tuple[float, float]]) -> list[str]:
    """A sentence for every estimate (value, deviation) that is surely on the wrong side of zero."""
    return [
        f"{name} = {estimates[name][0]:+.4g} has the wrong sign: {meaning}. If the file counts {channel} the other "
        "way, write sign = -1 at that channel on the card."
        for name, (sign, channel, meaning) in EXPECTED.items()
        if name in estimates and sign * estimates[name][0] < -SURE * estimates[name][1]
    ]
