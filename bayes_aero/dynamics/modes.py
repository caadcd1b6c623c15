"""Modes of motion about steady flight with fixed controls: eigenvalues of the linearised equations of motion.

Source: Etkin and Reid, *Dynamics of Flight*, 3rd ed. 1996, ch. 6.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.dynamics.aircraft import HELD, RigidBody
from bayes_aero.dynamics.flight import AircraftDynamics, Dynamics
from bayes_aero.dynamics.linear import LinearDynamics
from bayes_aero.dynamics.simulated.trim import CONTROLS, SURFACES, Condition, rigid_trim
from bayes_aero.errors import InputError
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.atmosphere import GRAVITY
from bayes_aero.flight.channel import Axis

LATERAL = ("beta", "p", "r", "phi")
SPEEDS, HEAVES = ("airspeed", "u"), ("alpha", "w")  # u and w of cards with velocities in body axes, m/s
LONGITUDINAL = (*SPEEDS, *HEAVES, "q", "theta")
WITHOUT_FORCE = ("psi", "altitude")  # no force depends on psi, and hardly any on altitude

SHORT_PERIOD, PHUGOID, DUTCH_ROLL, ROLL, SPIRAL, OTHER = (
    "short period", "phugoid", "Dutch roll", "roll", "spiral", "other",
)  # fmt: skip


@dataclass(frozen=True)
class MotionMode:
    """A mode by name, with its eigenvalue (1/s), the one of positive imaginary part of a pair."""

    name: str
    eigenvalue: complex


@dataclass(frozen=True)
class Steady:
    """Straight level flight about which motion is linearised: airspeed m/s, altitude m, alpha rad. Alpha is used for
    cards without the longitudinal axis, which have no trim."""

    airspeed: float
    altitude: float
    alpha: float = 0.0


def modes(dynamics: Dynamics, values: Mapping[str, Any], aircraft: Aircraft, steady: Steady) -> tuple[MotionMode, ...]:
    """Modes of motion about steady flight with fixed controls, longitudinal ones first, the faster ones first.
    `aircraft` is that of the card; `steady` has no effect on a linear system."""
    if isinstance(dynamics, LinearDynamics):
        system, states = dynamics.system(values, aircraft), dynamics.states
        u = {name: jnp.zeros(()) for name in (*dynamics.inputs, *dynamics.rows.by_manoeuvre)}
        A = jax.jacfwd(lambda x: system.motion(x, u)[0])(jnp.zeros(len(states)))
        return named_modes(np.asarray(A), states, steady.airspeed)
    if not isinstance(dynamics, AircraftDynamics):
        raise InputError("a flight path of recorded accelerations has no modes of motion; fly a model of the aircraft")
    held = set(dynamics.held) - {"altitude", "psi"}
    if held:
        raise InputError(f"the card holds {', '.join(sorted(held))} to the record; leave [fly] held out for modes")
    model, axes = dynamics.model, set(dynamics.model.axes)
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    actual = model.actual_aircraft(values, aircraft)
    own = HELD[Axis.LONGITUDINAL] if Axis.LONGITUDINAL not in axes else ()
    wider = model if own else replace(model, axes=tuple(Axis))
    u = dict.fromkeys((*CONTROLS, "aileron", "rudder", *SURFACES), 0.0)
    if own:  # prescribed as in level flight
        x, alpha = {}, steady.alpha
        u |= dict.fromkeys(("q", "alpha_dot", "p_dot", "q_dot", "r_dot", "thrust", "thrust_left", "thrust_right"), 0.0)
        u |= {"airspeed": steady.airspeed, "alpha": alpha, "theta": alpha, "altitude": steady.altitude}
        u |= {"force_x": GRAVITY * math.sin(alpha), "force_z": -GRAVITY * math.cos(alpha)}
    else:
        trim = rigid_trim(wider, values, actual, Condition(steady.airspeed, steady.altitude))
        x, half = trim.state, 0.5 * trim.thrust
        u |= {n: trim.controls[n] for n in u if n in trim.controls} | {"altitude": trim.state["altitude"]}
        u |= {"thrust": trim.thrust, "thrust_left": half, "thrust_right": half}
    # arrays: one program for every trim
    x, u = ({name: jnp.asarray(value, float) for name, value in given.items()} for given in (x, u))
    body = RigidBody(wider, values, actual, altitude=False, held=own, heading=False, euler=True)
    gusts = {d.state for d in wider.disturbances}
    states = tuple(n for n in body.start if n not in gusts)
    A = _linearised(body, states, x, u)
    kept = [k for k, n in enumerate(states) if Axis.LATERAL in axes or n not in LATERAL]
    return named_modes(np.asarray(A)[np.ix_(kept, kept)], [states[k] for k in kept], steady.airspeed)


def named_modes(A: Float[np.ndarray, "s s"], states: Sequence[str], airspeed: float) -> tuple[MotionMode, ...]:
    """Eigenvalues of the derivative `A` of the rates of `states` by them, SI, by the names of the modes. Velocities are
    scaled to angles by the airspeed, m/s. A mode whose motion no name fits is called "other"."""
    if not np.all(np.isfinite(A)):
        raise InputError("the equations of motion are not finite about steady flight; check the card's constants")
    kept = [k for k, n in enumerate(states) if n not in WITHOUT_FORCE]
    own = [states[k] for k in kept]
    eigenvalues, vectors = np.linalg.eig(np.asarray(A, float)[np.ix_(kept, kept)])
    scale = np.array([1.0 / airspeed if n in ("airspeed", "u", "w") else 1.0 for n in own])
    found = []
    for value, vector in zip(eigenvalues, vectors.T, strict=True):
        if value.imag >= 0.0:
            found.append((complex(value), dict(zip(own, np.abs(vector) * scale, strict=True))))
    found.sort(key=lambda pair: -abs(pair[0]))
    lateral = [one for one in found if _share(one[1], LATERAL) > 0.5]
    rest = [one for one in found if _share(one[1], LATERAL) <= 0.5]
    return (*_longitudinal(rest), *_lateral(lateral, own))


Eigenmotions = list[tuple[complex, dict[str, float]]]


def _share(motion: Mapping[str, float], names: Sequence[str]) -> float:
    """Share of `names` in the squared motion."""
    return sum(motion.get(n, 0.0) ** 2 for n in names) / sum(x**2 for x in motion.values())


def _longitudinal(found: Eigenmotions) -> list[MotionMode]:
    """The faster oscillation is the short period, the slower one the phugoid. A single one is the short period if alpha
    varies more than speed."""
    oscillations = [k for k, (value, _) in enumerate(found) if value.imag > 0.0]
    both = dict(zip(oscillations, (SHORT_PERIOD, PHUGOID), strict=False)) if len(oscillations) > 1 else {}
    named = []
    for k, (value, motion) in enumerate(found):
        name = SHORT_PERIOD if _share(motion, HEAVES) >= _share(motion, SPEEDS) else PHUGOID
        known = _share(motion, LONGITUDINAL) > 0.5
        aperiodic = "" if value.imag > 0.0 else ", aperiodic"
        named.append(MotionMode(both.get(k, f"{name}{aperiodic}" if known else OTHER), value))
    return named


def _lateral(found: Eigenmotions, states: Sequence[str]) -> list[MotionMode]:
    """The oscillation with most sideslip is the Dutch roll; the fastest aperiodic mode is the roll mode. Without
    sideslip there is neither a Dutch roll nor a spiral, without bank no spiral."""
    oscillations = sorted((one for one in found if one[0].imag > 0.0), key=lambda one: -_share(one[1], ("beta",)))
    aperiodic = [one for one in found if one[0].imag == 0.0]
    names = (DUTCH_ROLL, "lateral phugoid") if "beta" in states else ()
    named = [MotionMode(names[k] if k < len(names) else OTHER, value) for k, (value, _) in enumerate(oscillations)]
    first = min(aperiodic, key=lambda one: -_share(one[1], ("p",))) if "beta" not in states and aperiodic else None
    roll = first or (aperiodic[0] if aperiodic else None)
    spiral = aperiodic[-1] if {"beta", "phi"} <= set(states) and len(aperiodic) > 1 else None
    for one in aperiodic:
        name = ROLL if one is roll and "p" in states else SPIRAL if one is spiral else OTHER
        named.append(MotionMode(name, one[0]))
    return named


@eqx.filter_jit
def _linearised(
    body: RigidBody, moving: tuple[str, ...], x: Mapping[str, Any], u: Mapping[str, Any]
) -> Float[Array, "s s"]:
    """Derivative of the rates of the `moving` states by them, altitude and controls held."""
    start = body.complete_start(jnp.stack([jnp.asarray(x.get(name, 0.0), float) for name in body.start]), dict(u))
    places = jnp.array([body.start.index(n) for n in moving])

    def rates(part):
        return body.motion(body.state_at_start(start.at[places].set(part)), dict(u))[0][places]

    return jax.jacfwd(rates)(start[places])
