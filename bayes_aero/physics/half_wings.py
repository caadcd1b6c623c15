"""Moments due to a difference between the right and the left wing."""

from __future__ import annotations

import math

from bayes_aero.arrays import Samples, xp
from bayes_aero.flight.aircraft import Aircraft

CENTROID = 4.0 / (3.0 * math.pi)  # of half an elliptic lift distribution, share of the half span


def moments_of_difference(CL: Samples, CD: Samples, alpha: Samples, aircraft: Aircraft) -> dict[str, Samples]:
    """Cl and Cn of differences of lift and drag, right less left wing.

    `CL` and `CD` are coefficients of a wing with both halves like the right one, less those with both halves like the
    left one. The force of a half acts at `CENTROID`. Moments are about body axes.
    """
    CX = CL * xp.sin(alpha) - CD * xp.cos(alpha)
    CZ = -CL * xp.cos(alpha) - CD * xp.sin(alpha)
    arm = 0.5 * CENTROID * aircraft.half_span / aircraft.moment_length
    return {"Cl": arm * CZ, "Cn": -arm * CX}
