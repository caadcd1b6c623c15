"""Rigid-body kinematics and dynamics: attitude, angular accelerations, lever arm of accelerometers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from bayes_aero.arrays import Samples, xp
from bayes_aero.flight.aircraft import Aircraft, Position

RATES = ("p", "q", "r")


class Rotation(NamedTuple):
    """Body rates (rad/s) and angular accelerations (rad/s2)."""

    p: Samples
    q: Samples
    r: Samples
    p_dot: Samples
    q_dot: Samples
    r_dot: Samples


def inertial_moments(rotation: Rotation, aircraft: Aircraft) -> tuple[Samples, Samples, Samples]:
    """Moments about body x, y and z (N m) of a rotation: I omega_dot + omega x (I omega).

    Full inertia tensor; Ixy, Ixz, Iyz are the integrals of the products (a nose-down principal axis has Ixz > 0).
    Source: Etkin and Reid, *Dynamics of Flight*, 3rd ed. 1996, eq. 4.3,5.
    """
    p, q, r, p_dot, q_dot, r_dot = rotation
    a = aircraft
    hx = a.Ix * p - a.Ixy * q - a.Ixz * r
    hy = a.Iy * q - a.Ixy * p - a.Iyz * r
    hz = a.Iz * r - a.Ixz * p - a.Iyz * q
    L = a.Ix * p_dot - a.Ixy * q_dot - a.Ixz * r_dot + q * hz - r * hy
    M = a.Iy * q_dot - a.Ixy * p_dot - a.Iyz * r_dot + r * hx - p * hz
    N = a.Iz * r_dot - a.Ixz * p_dot - a.Iyz * q_dot + p * hy - q * hx
    return L, M, N


def angular_accelerations(
    moments: tuple[Samples, Samples, Samples],
    rates: tuple[Samples, Samples, Samples],
    aircraft: Aircraft,
    given: Mapping[str, Samples],
) -> tuple[Samples, Samples, Samples]:
    """p_dot, q_dot, r_dot (rad/s2) from moments about the CG (N m): Euler's equations, `inertial_moments` solved.

    `rates` are p, q, r in rad/s. `given` has the accelerations `p_dot`, `q_dot`, `r_dot` of axes whose rate is
    prescribed; the moment about such an axis is then not used.
    """
    a, nothing = aircraft, xp.zeros_like(rates[0])
    turning = inertial_moments(Rotation(*rates, nothing, nothing, nothing), a)
    rows = [(a.Ix, -a.Ixy, -a.Ixz), (-a.Ixy, a.Iy, -a.Iyz), (-a.Ixz, -a.Iyz, a.Iz)]
    right = [m - t for m, t in zip(moments, turning, strict=True)]
    for i, name in enumerate(RATES):
        if f"{name}_dot" in given:
            rows[i] = tuple(float(i == j) for j in range(3))  # type: ignore[call-overload]
            right[i] = given[f"{name}_dot"]
    first, second, third = rows
    columns = _cross(second, third), _cross(third, first), _cross(first, second)
    determinant = sum(x * y for x, y in zip(first, columns[0], strict=True))
    p_dot, q_dot, r_dot = (sum(c[i] * m for c, m in zip(columns, right, strict=True)) / determinant for i in range(3))
    return p_dot, q_dot, r_dot


def _cross(a: tuple[Any, Any, Any], b: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def euler_rates(
    rates: tuple[Samples, Samples, Samples], phi: Samples, theta: Samples
) -> tuple[Samples, Samples, Samples]:
    """Time derivatives of phi, theta, psi (rad/s) from p, q, r (rad/s); singular at 90 degrees of pitch.

    Source: Etkin and Reid, *Dynamics of Flight*, 3rd ed. 1996, eq. 4.4,7.
    """
    p, q, r = rates
    sin, cos = xp.sin(phi), xp.cos(phi)
    psi_dot = (q * sin + r * cos) / xp.cos(theta)
    return p + psi_dot * xp.sin(theta), q * cos - r * sin, psi_dot


class Attitude(NamedTuple):
    """A quaternion from earth to body axes, of any length, with scalar part e0; without a singularity.

    Source: Stevens, Lewis, Johnson, *Aircraft Control and Simulation*, 3rd ed. 2016, ch. 1.8.
    """

    e0: Samples
    e1: Samples
    e2: Samples
    e3: Samples

    @classmethod
    def of(cls, phi: Samples, theta: Samples, psi: Samples) -> Attitude:
        """From bank, pitch and heading, rad."""
        sx, sy, sz = (xp.sin(0.5 * x) for x in (phi, theta, psi))
        cx, cy, cz = (xp.cos(0.5 * x) for x in (phi, theta, psi))
        return cls(
            cx * cy * cz + sx * sy * sz,
            sx * cy * cz - cx * sy * sz,
            cx * sy * cz + sx * cy * sz,
            cx * cy * sz - sx * sy * cz,
        )

    def turned(self, rates: tuple[Samples, Samples, Samples]) -> Attitude:
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
    def down(self) -> tuple[Samples, Samples, Samples]:
        """The direction of gravity in body axes."""
        e0, e1, e2, e3 = self
        size = e0 * e0 + e1 * e1 + e2 * e2 + e3 * e3
        x, y = 2.0 * (e1 * e3 - e0 * e2) / size, 2.0 * (e2 * e3 + e0 * e1) / size
        return x, y, (e0 * e0 - e1 * e1 - e2 * e2 + e3 * e3) / size

    @property
    def angles(self) -> tuple[Samples, Samples, Samples]:
        """phi, theta, psi in rad: bank and heading to half a turn either way, pitch to a quarter."""
        e0, e1, e2, e3 = self
        x, y, z = self.down
        north, east = e0 * e0 + e1 * e1 - e2 * e2 - e3 * e3, 2.0 * (e1 * e2 + e0 * e3)
        return xp.arctan2(y, z), xp.arctan2(-x, xp.hypot(y, z)), xp.arctan2(east, north)


def down_of(phi: Samples, theta: Samples) -> tuple[Samples, Samples, Samples]:
    """The direction of gravity in body axes at this bank and pitch, rad."""
    return -xp.sin(theta), xp.cos(theta) * xp.sin(phi), xp.cos(theta) * xp.cos(phi)


def lever_arm(rotation: Rotation, position: Position) -> tuple[Samples, Samples, Samples]:
    """Acceleration (m/s2) at `position` (m, from the CG) relative to the CG: omega_dot x r + omega x (omega x r).

    Full rigid-body expression, lateral terms too; Klein and Morelli, *Aircraft System Identification*, 2006, ch. 10.
    """
    p, q, r, p_dot, q_dot, r_dot = rotation
    x, y, z = position
    ax = -x * (q * q + r * r) + y * (p * q - r_dot) + z * (p * r + q_dot)
    ay = x * (p * q + r_dot) - y * (p * p + r * r) + z * (q * r - p_dot)
    az = x * (p * r - q_dot) + y * (q * r + p_dot) - z * (p * p + q * q)
    return ax, ay, az
