"""The flow separation point X on the upper surface: 1 attached, 0 separated from the leading edge.

Source: Goman and Khrabrov, J. Aircraft 31 (1994) 1109; Fischenberg and Jategaonkar, RTO MP-11 (1999) paper 17.
"""

from __future__ import annotations

import math

from jaxtyping import Bool, Float

from bayes_aero.arrays import AnyArray, Samples, xp
from bayes_aero.physics.aircraft import Aircraft
from bayes_aero.physics.filters import recurrence
from bayes_aero.physics.kinematics import across_flow

Scalar = Float[AnyArray, ""]


def separation_point(a1: Scalar, alpha: Samples, alpha_star: Scalar) -> Samples:
    """Static X = (1 - tanh(a1 (alpha - alpha_star)))/2, with alpha in rad and a1 in 1/rad. Written as a logistic so
    that X and its root keep finite derivatives when the flow is fully separated."""
    import jax

    return jax.nn.sigmoid(-2.0 * a1 * (alpha - alpha_star))


def root(X: Samples) -> Samples:
    """sqrt X with a finite derivative at X = 0 (Kirchhoff's lift uses the root)."""
    return xp.sqrt(xp.maximum(X, 1e-30))


def kirchhoff_factor(X: Samples) -> Samples:
    """((1 + sqrt X)/2)^2: share of the attached lift-curve slope that Kirchhoff's flow keeps."""
    return xp.square((1.0 + root(X)) / 2.0)


def kept_lift(X: Samples, difference: Samples) -> Samples:
    """The same of two wings, half each: mean X, and `difference` of the right one's less the left one's."""
    half = difference / 2.0
    return (kirchhoff_factor(X + half) + kirchhoff_factor(X - half)) / 2.0


def lagged(
    X_static: Float[AnyArray, " n"], tau: Float[AnyArray, " n"], dt: Float[AnyArray, " n"], start: Bool[AnyArray, " n"]
):
    """Solve tau dX/dt + X = X_static over manoeuvres laid end to end; the state restarts where `start` is true. `tau`
    and `dt` (time since the previous sample) in s. Exact for an input linear between samples and tau constant over a
    step; tau = 0 gives X_static exactly, with the correct derivative there: dX/dtau = -dX_static/dt."""
    import jax.numpy as jnp

    ratio = tau / dt
    safe = jnp.where(ratio > 1e-3, ratio, 1.0)
    decay = jnp.where(ratio > 1e-3, jnp.exp(-1.0 / safe), 0.0)
    new = 1.0 - ratio * (1.0 - decay)
    old = 1.0 - decay - new
    previous = jnp.concatenate([X_static[:1], X_static[:-1]])
    drive = jnp.where(start, X_static, new * X_static + old * previous)
    keep = jnp.where(start, 0.0, decay)

    return recurrence(keep, drive)


# --- Moments due to a difference between the right and the left wing.

CENTROID = 4.0 / (3.0 * math.pi)  # of half an elliptic lift distribution, share of the half span


def moments_of_difference(CL: Samples, CD: Samples, alpha: Samples, aircraft: Aircraft) -> dict[str, Samples]:
    """Cl and Cn, body axes, of lift and drag of a wing with both halves like the right one, less those of both like the
    left one; the force of a half acts at `CENTROID`."""
    CX, CZ = across_flow(CL, CD, alpha)
    arm = 0.5 * CENTROID * aircraft.half_span / aircraft.moment_length
    return {"Cl": arm * CZ, "Cn": -arm * CX}
