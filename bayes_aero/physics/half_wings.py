"""Moments of a left and a right wing that do not carry the same."""

from __future__ import annotations

import math

from bayes_aero.arrays import Samples, xp
from bayes_aero.flight.aircraft import Aircraft

CENTROID = 4.0 / (3.0 * math.pi)  # of half an elliptic lift distribution, share of the half span


def moments_of_difference(CL: Samples, CD: Samples, alpha: Samples, aircraft: Aircraft) -> dict[str, Samples]:
    """Cl and Cn of differences of lift and drag, right less left wing.

    `CL` and `CD` are those of a whole wing of which both halves were like the right one, less those of one like the
    left: either half carries half of its own, at `CENTROID`. Moments are about body axes.
    """
    CX = CL * xp.sin(alpha) - CD * xp.cos(alpha)
    CZ = -CL * xp.cos(alpha) - CD * xp.sin(alpha)
    arm = 0.5 * CENTROID * aircraft.half_span / aircraft.moment_length
    return {"Cl": arm * CZ, "Cn": -arm * CX}
