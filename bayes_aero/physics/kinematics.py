"""Flight-path kinematics: time derivatives of attitude, airspeed, flow angles and altitude from inertial sensors.

No aerodynamics: rates and specific forces at the centre of gravity give the derivatives of what other sensors measure.
Flat earth, air mass at rest. Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 10.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_aero.arrays import AnyArray, Samples, namespace, xp
from bayes_aero.physics.aircraft import GRAVITY, Aircraft, Position

PATH = ("airspeed", "alpha", "theta", "altitude")
LATERAL = ("beta", "phi")  # flight-path outputs of records whose lateral motion was flown and recorded
PATH_CORE = ("ax", "az", "q", "theta", "alpha", "airspeed")  # without these there is no flight path
STRAIGHT = ("ay", "p", "r", "phi", "beta")  # zero in symmetric flight, and taken as zero where not recorded
PATH_NEEDS = ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "alpha", "beta", "airspeed", "altitude")
FLOW_ANGLES = ("alpha", "beta")
ANGLES = (*FLOW_ANGLES, "theta", "phi")

Axes = tuple[Samples, Samples, Samples]  # along body x, y and z
Sines = tuple[Samples, ...]  # sine and cosine of each of `ANGLES`


def path_rates(s: Mapping[str, Samples], aircraft: Aircraft, sines: Sines | None = None) -> dict[str, Samples]:
    """`motion_of_path`, SI, from `PATH_NEEDS` and `p_dot`, `q_dot`, `r_dot`; accelerations at the sensor."""
    rotation = Rotation(s["p"], s["q"], s["r"], s["p_dot"], s["q_dot"], s["r_dot"])
    x, y, z = lever_arm(rotation, aircraft.accelerometer)
    return motion_of_path(s, (s["ax"] - x, s["ay"] - y, s["az"] - z), sines)


def _sines(s: Mapping[str, Samples], angles: Sequence[str] = ANGLES) -> Sines:
    """Sine and cosine of each of `angles`."""
    return tuple(f(s[name]) for name in angles for f in (xp.sin, xp.cos))


def motion_of_path(s: Mapping[str, Samples], force: Axes, sines: Sines | None = None) -> dict[str, Samples]:
    """Rates of airspeed (m/s2), alpha, beta, theta, phi (rad/s), altitude (m/s) from the specific force at the CG."""
    sines = _sines(s) if sines is None else sines
    sin_t, cos_t, sin_p, cos_p = sines[4:]
    down = -sin_t, cos_t * sin_p, cos_t * cos_p
    return motion_over_ground(s, force, down, sines) | {
        "theta": s["q"] * cos_p - s["r"] * sin_p,
        "phi": s["p"] + (s["q"] * sin_p + s["r"] * cos_p) * sin_t / cos_t,
    }


def motion_over_ground(
    s: Mapping[str, Samples], force: Axes, down: Axes, sines: Sines | None = None
) -> dict[str, Samples]:
    """Rates of airspeed, alpha, beta and altitude; `force`: specific, at the CG, `down`: of gravity, in body axes."""
    sin_a, cos_a, sin_b, cos_b = (_sines(s, FLOW_ANGLES) if sines is None else sines)[:4]
    ax, ay, az = (f + GRAVITY * d for f, d in zip(force, down, strict=True))
    V, across = s["airspeed"], ay * cos_b - (ax * cos_a + az * sin_a) * sin_b
    return {
        "airspeed": ax * cos_a * cos_b + ay * sin_b + az * sin_a * cos_b,
        "alpha": s["q"] - sin_b / cos_b * (s["p"] * cos_a + s["r"] * sin_a) + (az * cos_a - ax * sin_a) / (V * cos_b),
        "altitude": -V * (cos_a * cos_b * down[0] + sin_b * down[1] + sin_a * cos_b * down[2]),
        "beta": across / V + s["p"] * sin_a - s["r"] * cos_a,
    }


def path_outputs(channels: Mapping[str, Samples]) -> tuple[str, ...]:
    """Flight-path outputs that (n,) channels allow, none without `PATH_CORE`: what was recorded of `PATH`, and of
    `LATERAL` what moves, for a constant is no measurement; nor is bank without the rates that move it."""
    if not set(PATH_CORE) <= set(channels):
        return ()
    recorded = tuple(name for name in PATH if name in channels)
    moves = {n for n in PATH_NEEDS if n in channels and float(np.ptp(np.asarray(channels[n]))) > 0.0}
    sideslip = ("beta",) if {"beta", "ay"} <= moves else ()
    return (*recorded, *sideslip, *(("phi",) if {"phi", "p"} <= moves and "r" in channels else ()))


def as_symmetric(channels: Mapping[str, AnyArray]) -> dict[str, AnyArray]:
    """(n,) channels with zeros for what symmetric flight lacks (`STRAIGHT`) and was not recorded."""
    nothing = xp.zeros_like(channels["q"])
    return {name: nothing for name in STRAIGHT if name not in channels} | dict(channels)


def side_force(s: Mapping[str, Samples], ax: Samples, az: Samples) -> Samples:
    """Lateral specific force, m/s2, without which sideslip would not have moved as it did (v_dot + r u - p w with
    v = V sin(beta)): `ay` from the vane. `ax`, `az`: the specific forces beside it, at the centre of gravity."""
    sin_a, cos_a, sin_b, cos_b, sin_t, cos_t, sin_p, cos_p = _sines(s)
    in_plane = (ax - GRAVITY * sin_t) * cos_a + (az + GRAVITY * cos_t * cos_p) * sin_a
    turning = s["airspeed"] * (s["beta_dot"] + s["r"] * cos_a - s["p"] * sin_a)
    airspeed_dot = in_plane / cos_b + turning * sin_b / cos_b
    return airspeed_dot * sin_b + turning * cos_b - GRAVITY * cos_t * sin_p


def integral(
    rate: Float[AnyArray, "*r n"], dt: Float[AnyArray, " n"], start: Bool[AnyArray, " n"], first: Int[AnyArray, " n"]
) -> Float[AnyArray, "*r n"]:
    """Running trapezoidal integral, anew from zero in each manoeuvre (`start` marks, `first` indexes its beginning)."""
    lib = namespace(rate, dt)
    before = lib.concatenate([rate[..., :1], rate[..., :-1]], axis=-1)
    total = lib.cumsum(lib.where(start, 0.0, 0.5 * dt * (rate + before)), axis=-1)
    return total - total[..., first]


# --- Rigid-body kinematics and dynamics: attitude, angular accelerations, lever arm of accelerometers.

RATES = ("p", "q", "r")


class Rotation(NamedTuple):
    """Body rates (rad/s) and angular accelerations (rad/s2)."""

    p: Samples
    q: Samples
    r: Samples
    p_dot: Samples
    q_dot: Samples
    r_dot: Samples


def inertial_moments(rotation: Rotation, aircraft: Aircraft) -> Axes:
    """Moments about body x, y and z (N m) of a rotation: I omega_dot + omega x (I omega). Full inertia tensor; Ixy,
    Ixz, Iyz are the integrals of the products (a nose-down principal axis has Ixz > 0). Source: Etkin and Reid,
    *Dynamics of Flight*, 3rd ed. 1996, eq. 4.3,5."""
    p, q, r, p_dot, q_dot, r_dot = rotation
    a = aircraft
    hx = a.Ix * p - a.Ixy * q - a.Ixz * r
    hy = a.Iy * q - a.Ixy * p - a.Iyz * r
    hz = a.Iz * r - a.Ixz * p - a.Iyz * q
    L = a.Ix * p_dot - a.Ixy * q_dot - a.Ixz * r_dot + q * hz - r * hy
    M = a.Iy * q_dot - a.Ixy * p_dot - a.Iyz * r_dot + r * hx - p * hz
    N = a.Iz * r_dot - a.Ixz * p_dot - a.Iyz * q_dot + p * hy - q * hx
    return L, M, N


def angular_accelerations(moments: Axes, rates: Axes, aircraft: Aircraft, given: Mapping[str, Samples]) -> Axes:
    """p_dot, q_dot, r_dot (rad/s2) from moments about the CG (N m): `inertial_moments` solved. `given`: those of axes
    whose rate is prescribed; the moment about such an axis is then not used."""
    a, nothing = aircraft, xp.zeros_like(rates[0])
    turning = inertial_moments(Rotation(*rates, nothing, nothing, nothing), a)
    rows = [(a.Ix, -a.Ixy, -a.Ixz), (-a.Ixy, a.Iy, -a.Iyz), (-a.Ixz, -a.Iyz, a.Iz)]
    right = [m - t for m, t in zip(moments, turning, strict=True)]
    for i, name in enumerate(RATES):
        if f"{name}_dot" in given:
            rows[i] = tuple(float(i == j) for j in range(3))  # type: ignore[call-overload]
            right[i] = given[f"{name}_dot"]
    first, second, third = rows
    columns = [
        (b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0])
        for b, c in ((second, third), (third, first), (first, second))
    ]
    determinant = sum(x * y for x, y in zip(first, columns[0], strict=True))
    p_dot, q_dot, r_dot = (sum(c[i] * m for c, m in zip(columns, right, strict=True)) / determinant for i in range(3))
    return p_dot, q_dot, r_dot


def euler_rates(rates: Axes, phi: Samples, theta: Samples) -> Axes:
    """Time derivatives of phi, theta, psi (rad/s) from p, q, r (rad/s); singular at 90 degrees of pitch. Source: Etkin
    and Reid, *Dynamics of Flight*, 3rd ed. 1996, eq. 4.4,7."""
    p, q, r = rates
    sin, cos = xp.sin(phi), xp.cos(phi)
    psi_dot = (q * sin + r * cos) / xp.cos(theta)
    return p + psi_dot * xp.sin(theta), q * cos - r * sin, psi_dot


class Attitude(NamedTuple):
    """A quaternion from earth to body axes, of any length, with scalar part e0; without a singularity. Source: Stevens,
    Lewis, Johnson, *Aircraft Control and Simulation*, 3rd ed. 2016, ch. 1.8."""

    e0: Samples
    e1: Samples
    e2: Samples
    e3: Samples

    @classmethod
    def of(cls, phi: Samples, theta: Samples, psi: Samples) -> Attitude:
        """From bank, pitch and heading, rad."""
        sx, sy, sz = (xp.sin(0.5 * x) for x in (phi, theta, psi))
        cx, cy, cz = (xp.cos(0.5 * x) for x in (phi, theta, psi))
        first, second = cx * cy * cz + sx * sy * sz, sx * cy * cz - cx * sy * sz
        return cls(first, second, cx * sy * cz + sx * cy * sz, cx * cy * sz - sx * sy * cz)

    def turned(self, rates: Axes) -> Attitude:
        """Its time derivative, 1/s, at body rates p, q, r in rad/s."""
        e0, e1, e2, e3 = self
        p, q, r = rates
        return Attitude(
            -0.5 * (e1 * p + e2 * q + e3 * r),
            0.5 * (e0 * p + e2 * r - e3 * q),
            0.5 * (e0 * q + e3 * p - e1 * r),
            0.5 * (e0 * r + e1 * q - e2 * p),
        )

    @property
    def down(self) -> Axes:
        """The direction of gravity in body axes."""
        e0, e1, e2, e3 = self
        size = e0 * e0 + e1 * e1 + e2 * e2 + e3 * e3
        x, y = 2.0 * (e1 * e3 - e0 * e2) / size, 2.0 * (e2 * e3 + e0 * e1) / size
        return x, y, (e0 * e0 - e1 * e1 - e2 * e2 + e3 * e3) / size

    @property
    def angles(self) -> Axes:
        """phi, theta, psi in rad: bank and heading to half a turn either way, pitch to a quarter."""
        e0, e1, e2, e3 = self
        x, y, z = self.down
        north, east = e0 * e0 + e1 * e1 - e2 * e2 - e3 * e3, 2.0 * (e1 * e2 + e0 * e3)
        return xp.arctan2(y, z), xp.arctan2(-x, xp.hypot(y, z)), xp.arctan2(east, north)


def down_of(phi: Samples, theta: Samples) -> Axes:
    """The direction of gravity in body axes at this bank and pitch, rad."""
    return -xp.sin(theta), xp.cos(theta) * xp.sin(phi), xp.cos(theta) * xp.cos(phi)


def lever_arm(rotation: Rotation, position: Position) -> Axes:
    """Acceleration (m/s2) at `position` (m, from the CG) relative to the CG: omega_dot x r + omega x (omega x r). Full
    rigid-body expression, lateral terms too; Klein and Morelli, *Aircraft System Identification*, 2006, ch. 10."""
    p, q, r, p_dot, q_dot, r_dot = rotation
    x, y, z = position
    ax = -x * (q * q + r * r) + y * (p * q - r_dot) + z * (p * r + q_dot)
    ay = x * (p * q + r_dot) - y * (p * p + r * r) + z * (q * r - p_dot)
    az = x * (p * r - q_dot) + y * (q * r + p_dot) - z * (p * p + q * q)
    return ax, ay, az


def across_flow(along: Samples, down: Samples, alpha: Samples) -> tuple[Samples, Samples]:
    """Lift and drag from forces along body x and z (CL = CX sin alpha - CZ cos alpha, CD = -CX cos alpha - CZ sin
    alpha), and the other way: a reflection, its own inverse."""
    sin, cos = xp.sin(alpha), xp.cos(alpha)
    return along * sin - down * cos, -along * cos - down * sin


# --- Nondimensional rates and speeds of aerodynamic derivatives.
# Texts differ in the length (chord, half chord, another one) and in the speed (present, or of the trim point). A card
# states them under [aircraft] as `rate_length`, `lateral_rate_length` and `reference_speed`. Defaults are q c/V, p b/2V
# and r b/2V.

USUAL_SPEED = 100.0  # m/s, where the card names no reference speed; only keeps the ratio near one


def reduced(rate: Samples, airspeed: Samples, aircraft: Aircraft) -> Samples:
    """A rate (rad/s, or a multiple of one) times length over speed (m, m/s)."""
    length = aircraft.chord if aircraft.rate_length is None else aircraft.rate_length
    return rate * length / (airspeed if aircraft.reference_speed is None else aircraft.reference_speed)


def reduced_lateral(rate: Samples, airspeed: Samples, aircraft: Aircraft) -> Samples:
    """A roll or yaw rate (rad/s) times length over speed (m, m/s); b/2V unless the card says otherwise."""
    length = aircraft.half_span if aircraft.lateral_rate_length is None else aircraft.lateral_rate_length
    return rate * length / (airspeed if aircraft.reference_speed is None else aircraft.reference_speed)


def speed_ratio(airspeed: Samples, aircraft: Aircraft) -> Samples:
    """V/V0, of V0 the card's reference speed, or 100 m/s where it names none."""
    return airspeed / (USUAL_SPEED if aircraft.reference_speed is None else aircraft.reference_speed)
