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
from bayes_aero.flight.aircraft import NO_AIRCRAFT, Aircraft
from bayes_aero.flight.atmosphere import GRAVITY
from bayes_aero.flight.channel import Axis
from bayes_aero.model.model import Model

LATERAL = ("beta", "p", "r", "phi")
SPEEDS, HEAVES = ("airspeed", "u"), ("alpha", "w")  # u and w of cards with velocities in body axes, m/s
LONGITUDINAL = (*SPEEDS, *HEAVES, "q", "theta")
WITHOUT_FORCE = ("psi", "altitude")  # no force depends on psi, and hardly any on altitude

SHORT_PERIOD, PHUGOID, DUTCH_ROLL, ROLL, SPIRAL, OTHER = (
    "short period", "phugoid", "Dutch roll", "roll", "spiral", "other",
)  # fmt: skip


@dataclass(frozen=True)
class Mode:
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


def modes(dynamics: Dynamics, values: Mapping[str, Any], aircraft: Aircraft, steady: Steady) -> tuple[Mode, ...]:
    """Modes of motion about steady flight with fixed controls.

    Args:
        dynamics: a linear system, or an aircraft under effects of either or both axes.
        values: all parameter values by name.
        aircraft: that of the card.
        steady: the flight about which the equations are linearised; of no effect on a linear system.

    Returns:
        The modes, longitudinal ones first, the faster ones first.

    Raises:
        InputError: there is no such flight, or the dynamics have no motion of their own.
    """
    if isinstance(dynamics, LinearDynamics):
        return named_modes(*_of_system(dynamics, values, aircraft), steady.airspeed)
    if not isinstance(dynamics, AircraftDynamics):
        raise InputError("a flight path of recorded accelerations has no modes of motion; fly a model of the aircraft")
    held = set(dynamics.held) - {"altitude", "psi"}
    if held:
        raise InputError(f"the card holds {', '.join(sorted(held))} to the record; leave [fly] held out for modes")
    model, axes = dynamics.model, set(dynamics.model.axes)
    values = {name: jnp.asarray(x, float) for name, x in values.items()}
    actual = model.actual_aircraft(values, aircraft)
    own = HELD[Axis.LONGITUDINAL] if Axis.LONGITUDINAL not in axes else ()
    x, u = _prescribed(steady) if own else _trimmed(replace(model, axes=tuple(Axis)), values, actual, steady)
    wider = model if own else replace(model, axes=tuple(Axis))
    A, states = _linearised(wider, values, actual, own, x, u), _moving(wider, own)
    kept = [k for k, n in enumerate(states) if Axis.LATERAL in axes or n not in LATERAL]
    return named_modes(np.asarray(A)[np.ix_(kept, kept)], [states[k] for k in kept], steady.airspeed)


def named_modes(A: Float[np.ndarray, "s s"], states: Sequence[str], airspeed: float) -> tuple[Mode, ...]:
    """Eigenvalues of a matrix of linear motion by the names of the modes.

    Args:
        A: derivative of the rates of `states` by them, SI.
        states: names of the channels.
        airspeed: m/s; scales velocities to angles.

    Returns:
        The modes; one whose motion no name fits is called "other".

    Raises:
        InputError: the matrix is not finite.
    """
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


Found = list[tuple[complex, dict[str, float]]]


def _share(motion: Mapping[str, float], names: Sequence[str]) -> float:
    """Share of `names` in the squared motion."""
    return sum(motion.get(n, 0.0) ** 2 for n in names) / sum(x**2 for x in motion.values())


def _longitudinal(found: Found) -> list[Mode]:
    """The faster oscillation is the short period, the slower one the phugoid. A single one is the short period if alpha
    varies more than speed."""
    oscillations = [k for k, (value, _) in enumerate(found) if value.imag > 0.0]
    both = dict(zip(oscillations, (SHORT_PERIOD, PHUGOID), strict=False)) if len(oscillations) > 1 else {}
    named = []
    for k, (value, motion) in enumerate(found):
        name = SHORT_PERIOD if _share(motion, HEAVES) >= _share(motion, SPEEDS) else PHUGOID
        known = _share(motion, LONGITUDINAL) > 0.5
        aperiodic = "" if value.imag > 0.0 else ", aperiodic"
        named.append(Mode(both.get(k, f"{name}{aperiodic}" if known else OTHER), value))
    return named


def _lateral(found: Found, states: Sequence[str]) -> list[Mode]:
    """The oscillation with most sideslip is the Dutch roll; the fastest aperiodic mode is the roll mode.

    Without sideslip there is neither a Dutch roll nor a spiral, without bank no spiral.
    """
    oscillations = sorted((one for one in found if one[0].imag > 0.0), key=lambda one: -_share(one[1], ("beta",)))
    aperiodic = [one for one in found if one[0].imag == 0.0]
    names = (DUTCH_ROLL, "lateral phugoid") if "beta" in states else ()
    named = [Mode(names[k] if k < len(names) else OTHER, value) for k, (value, _) in enumerate(oscillations)]
    first = min(aperiodic, key=lambda one: -_share(one[1], ("p",))) if "beta" not in states and aperiodic else None
    roll = first or (aperiodic[0] if aperiodic else None)
    spiral = aperiodic[-1] if {"beta", "phi"} <= set(states) and len(aperiodic) > 1 else None
    for one in aperiodic:
        name = ROLL if one is roll and "p" in states else SPIRAL if one is spiral else OTHER
        named.append(Mode(name, one[0]))
    return named


def _of_system(
    dynamics: LinearDynamics, values: Mapping[str, Any], aircraft: Aircraft
) -> tuple[np.ndarray, tuple[str, ...]]:
    system = dynamics.system(values, aircraft)
    u = {name: jnp.zeros(()) for name in (*dynamics.inputs, *dynamics.rows.by_manoeuvre)}
    return np.asarray(jax.jacfwd(lambda x: system.motion(x, u)[0])(jnp.zeros(len(dynamics.states)))), dynamics.states


def _prescribed(steady: Steady) -> tuple[dict[str, Any], dict[str, Any]]:
    """State and inputs of level flight with prescribed longitudinal motion."""
    u = dict.fromkeys((*CONTROLS, "aileron", "rudder", *SURFACES, "q", "alpha_dot", "p_dot", "q_dot", "r_dot"), 0.0)
    u |= {"airspeed": steady.airspeed, "alpha": steady.alpha, "theta": steady.alpha, "altitude": steady.altitude}
    u |= {"force_x": GRAVITY * math.sin(steady.alpha), "force_z": -GRAVITY * math.cos(steady.alpha), "thrust": 0.0}
    u |= {"thrust_left": 0.0, "thrust_right": 0.0}
    return {}, {name: jnp.asarray(x, float) for name, x in u.items()}


def _trimmed(
    model: Model, values: Mapping[str, Any], aircraft: Aircraft, steady: Steady
) -> tuple[dict[str, Any], dict[str, Any]]:
    """State and inputs of level flight in trim."""
    trim = rigid_trim(model, values, aircraft, Condition(steady.airspeed, steady.altitude))
    u = {name: trim.controls.get(name, 0.0) for name in (*CONTROLS, "aileron", "rudder", *SURFACES)}
    u |= {"thrust": trim.thrust, "altitude": trim.state["altitude"]}
    u |= {f"thrust_{side}": 0.5 * trim.thrust for side in ("left", "right")}
    x, u = ({name: jnp.asarray(value, float) for name, value in given.items()} for given in (trim.state, u))
    return x, u  # arrays: one program for every trim


def _body(model: Model, values: Mapping[str, Any], aircraft: Aircraft, held: tuple[str, ...]) -> RigidBody:
    return RigidBody(model, dict(values), aircraft, altitude=False, held=held, heading=False, euler=True)


def _moving(model: Model, held: tuple[str, ...]) -> tuple[str, ...]:
    """States without gusts."""
    gusts = {d.state for d in model.disturbances}
    return tuple(n for n in _body(model, {}, NO_AIRCRAFT, held).start if n not in gusts)


@eqx.filter_jit
def _linearised(
    model: Model,
    values: Mapping[str, Any],
    aircraft: Aircraft,
    held: tuple[str, ...],
    x: Mapping[str, Any],
    u: Mapping[str, Any],
) -> Float[Array, "s s"]:
    """Derivative of the rates of the moving states by them, altitude and controls held."""
    body, moving = _body(model, values, aircraft, held), _moving(model, held)
    start = body.complete_start(jnp.stack([jnp.asarray(x.get(name, 0.0), float) for name in body.start]), dict(u))
    places = jnp.array([body.start.index(n) for n in moving])

    def rates(part):
        found = body.motion(body.state_at_start(start.at[places].set(part)), dict(u))[0]
        return found[places]

    return jax.jacfwd(rates)(start[places])
