"""Flight-path kinematics: time derivatives of attitude, airspeed, flow angles and altitude from inertial sensors.

No aerodynamics: rates and specific forces at the centre of gravity give the derivatives of what other sensors measure.
Flat earth, air mass at rest. Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 10.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_aero.arrays import Array, Samples, namespace, xp
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.physics.atmosphere import GRAVITY
from bayes_aero.physics.kinematics import Rotation, lever_arm

PATH = ("airspeed", "alpha", "theta", "altitude")
LATERAL = ("beta", "phi")  # flight-path outputs of records whose lateral motion was flown and recorded
PATH_CORE = ("ax", "az", "q", "theta", "alpha", "airspeed")  # without these there is no flight path
STRAIGHT = ("ay", "p", "r", "phi", "beta")  # zero in symmetric flight, and taken as zero where not recorded
PATH_NEEDS = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "alpha", "beta", "airspeed", "altitude")
FLOW_ANGLES = ("alpha", "beta")
ANGLES = (*FLOW_ANGLES, "theta", "phi")

Axes = tuple[Samples, Samples, Samples]
"""Along body x, y and z."""


def path_rates(
    s: Mapping[str, Samples], aircraft: Aircraft, sines: tuple[Samples, ...] | None = None
) -> dict[str, Samples]:
    """Time derivatives of airspeed (m/s2), alpha, theta, beta, phi (rad/s) and altitude (m/s) from signals in SI.

    `s` holds `PATH_NEEDS` and the angular accelerations `p_dot`, `q_dot`, `r_dot`; accelerations at the sensor.
    `sines`: sine and cosine of each of `ANGLES`, where they are known.
    """
    rotation = Rotation(s["p"], s["q"], s["r"], s["p_dot"], s["q_dot"], s["r_dot"])
    x, y, z = lever_arm(rotation, aircraft.accelerometer)
    force = (s["ax"] - x, s["ay"] - y, s["az"] - z)
    sines = _sines(s) if sines is None else sines
    return motion_of_path(s, force, sines) | lateral_motion(s, force, sines)


def _sines(s: Mapping[str, Samples], angles: Sequence[str] = ANGLES) -> tuple[Samples, ...]:
    """Sine and cosine of each of `angles`."""
    return tuple(f(s[name]) for name in angles for f in (xp.sin, xp.cos))


def _down(sines: tuple[Samples, ...]) -> Axes:
    """The direction of gravity in body axes."""
    sin_t, cos_t, sin_p, cos_p = sines[4:]
    return -sin_t, cos_t * sin_p, cos_t * cos_p


def motion_of_path(
    s: Mapping[str, Samples], force: Axes, sines: tuple[Samples, ...] | None = None
) -> dict[str, Samples]:
    """As `path_rates`, from the specific force at the centre of gravity (body axes, m/s2), without beta and phi."""
    sines = _sines(s) if sines is None else sines
    sin_p, cos_p = sines[6:]
    return motion_in_plane(s, force, _down(sines), sines) | {"theta": s["q"] * cos_p - s["r"] * sin_p}


def lateral_motion(
    s: Mapping[str, Samples], force: Axes, sines: tuple[Samples, ...] | None = None
) -> dict[str, Samples]:
    """Time derivatives of sideslip and bank (rad/s) from the specific force at the centre of gravity (m/s2)."""
    sines = _sines(s) if sines is None else sines
    sin_t, cos_t, sin_p, cos_p = sines[4:]
    return {
        "beta": sideslip_rate(s, force, _down(sines), sines),
        "phi": s["p"] + (s["q"] * sin_p + s["r"] * cos_p) * sin_t / cos_t,
    }


def motion_in_plane(
    s: Mapping[str, Samples], force: Axes, down: Axes, sines: tuple[Samples, ...] | None = None
) -> dict[str, Samples]:
    """Time derivatives of airspeed (m/s2), alpha (rad/s) and altitude (m/s).

    `force`: specific force at the centre of gravity, m/s2; `down`: the direction of gravity; both in body axes.
    """
    sin_a, cos_a, sin_b, cos_b = (_sines(s, FLOW_ANGLES) if sines is None else sines)[:4]
    ax, ay, az = _accelerations(force, down)
    V = s["airspeed"]
    return {
        "airspeed": ax * cos_a * cos_b + ay * sin_b + az * sin_a * cos_b,
        "alpha": s["q"] - sin_b / cos_b * (s["p"] * cos_a + s["r"] * sin_a) + (az * cos_a - ax * sin_a) / (V * cos_b),
        "altitude": -V * (cos_a * cos_b * down[0] + sin_b * down[1] + sin_a * cos_b * down[2]),
    }


def sideslip_rate(
    s: Mapping[str, Samples], force: Axes, down: Axes, sines: tuple[Samples, ...] | None = None
) -> Samples:
    """Time derivative of sideslip, rad/s; arguments as those of `motion_in_plane`."""
    sin_a, cos_a, sin_b, cos_b = (_sines(s, FLOW_ANGLES) if sines is None else sines)[:4]
    ax, ay, az = _accelerations(force, down)
    across = ay * cos_b - (ax * cos_a + az * sin_a) * sin_b
    return across / s["airspeed"] + s["p"] * sin_a - s["r"] * cos_a


def _accelerations(force: Axes, down: Axes) -> Axes:
    """With gravity, m/s2."""
    return force[0] + GRAVITY * down[0], force[1] + GRAVITY * down[1], force[2] + GRAVITY * down[2]


def path_outputs(channels: Mapping[str, Samples]) -> tuple[str, ...]:
    """Flight-path outputs that (n,) channels allow: what was recorded of `PATH`, and of `LATERAL` what moves.

    None without `PATH_CORE`. Sideslip that a card states as constant, or bank of wings that stayed level, is no
    measurement; nor is bank without both of the rates that move it.
    """
    if not set(PATH_CORE) <= set(channels):
        return ()
    recorded = tuple(name for name in PATH if name in channels)
    moves = {n for n in PATH_NEEDS if n in channels and float(np.ptp(np.asarray(channels[n]))) > 0.0}
    sideslip = ("beta",) if {"beta", "ay"} <= moves else ()
    return (*recorded, *sideslip, *(("phi",) if {"phi", "p"} <= moves and "r" in channels else ()))


def as_symmetric(channels: Mapping[str, Array]) -> dict[str, Array]:
    """(n,) channels with zeros for what symmetric flight lacks (`STRAIGHT`) and was not recorded."""
    nothing = xp.zeros_like(channels["q"])
    return {name: nothing for name in STRAIGHT if name not in channels} | dict(channels)


def side_force(s: Mapping[str, Samples], ax: Samples, az: Samples) -> Samples:
    """Lateral specific force in m/s2 without which sideslip would not have moved as it did: `ay` from the vane.

    From sideslip, its rate `beta_dot`, p and r: the lateral acceleration is v_dot + r u - p w with v = V sin(beta).
    `ax` and `az` are the specific forces beside it, at the centre of gravity; in sideslip they are not all that slows.
    """
    sin_a, cos_a, sin_b, cos_b, sin_t, cos_t, sin_p, cos_p = _sines(s)
    in_plane = (ax - GRAVITY * sin_t) * cos_a + (az + GRAVITY * cos_t * cos_p) * sin_a
    turning = s["airspeed"] * (s["beta_dot"] + s["r"] * cos_a - s["p"] * sin_a)
    airspeed_dot = in_plane / cos_b + turning * sin_b / cos_b
    return airspeed_dot * sin_b + turning * cos_b - GRAVITY * cos_t * sin_p


def integral(
    rate: Float[Array, "*r n"], dt: Float[Array, " n"], start: Bool[Array, " n"], first: Int[Array, " n"]
) -> Float[Array, "*r n"]:
    """Running trapezoidal integral, anew from zero in each manoeuvre (`start` marks, `first` indexes its beginning)."""
    own = namespace(rate, dt)
    before = own.concatenate([rate[..., :1], rate[..., :-1]], axis=-1)
    total = own.cumsum(own.where(start, 0.0, 0.5 * dt * (rate + before)), axis=-1)
    return total - total[..., first]
