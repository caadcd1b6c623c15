"""Rigid-body kinematics: what an accelerometer away from the centre of gravity feels."""

from __future__ import annotations

from typing import NamedTuple

from bayes_aero.arrays import Samples
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
    """Moments about body x, y and z (N m) that this rotation takes: I omega_dot + omega x (I omega).

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
