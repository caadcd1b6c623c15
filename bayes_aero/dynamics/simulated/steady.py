"""Steady flow: lift, drag and separation of a model at constant angle of attack."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model

NEAR_STALL = 0.1  # share of the samples, those with the largest lift, that represent the conditions at the stall
RATES = ("alpha_dot", "beta_dot", "p", "q", "r", "p_dot", "q_dot", "r_dot")


def conditions(signals: Mapping[str, Any]) -> dict[str, float]:
    """One value of every signal (SI): its median over the tenth of the samples with the largest lift; rates are zero.

    Lift is used and not angle of attack, because in a deep stall the elevator differs from that at the largest lift.
    Without an accelerometer the angle of attack is used.
    """
    alpha = np.asarray(signals["alpha"])
    lift = alpha
    if {"az", "density", "airspeed"} <= set(signals):
        lift = -np.asarray(signals["az"]) / (np.asarray(signals["density"]) * np.asarray(signals["airspeed"]) ** 2)
    high = lift >= np.quantile(lift, 1.0 - NEAR_STALL)
    found: dict[str, float] = {}
    for name, values in signals.items():
        array = np.asarray(values)
        if array.shape == alpha.shape and array.dtype.kind == "f":
            found[name] = float(np.median(array[high]))
    return {**found, **dict.fromkeys(RATES, 0.0)}


def steady_flow(
    model: Model,
    theta: Float[Array, " k"],
    alpha: Float[Array, " g"],
    alpha_dot: Float[Array, ""],
    reference: Mapping[str, Any],
    aircraft: Aircraft,
) -> dict[str, Float[Array, " g"]]:
    """X, CL, CD, Cm over `alpha` (rad), all other signals at `reference`; separation without lag.

    `alpha_dot` (rad/s) other than zero gives the quasi-steady flow of a model with hysteresis.
    """
    signals = {name: jnp.full_like(alpha, value) for name, value in reference.items()}
    signals |= {"alpha": alpha, "alpha_dot": jnp.full_like(alpha, alpha_dot)}
    values = model.values(theta)
    X = model.static_separation(values, signals, aircraft)
    known = model.flow(values, signals, aircraft, X)
    return {name: known[name] for name in ("X", "CL", "CD", "Cm")}
