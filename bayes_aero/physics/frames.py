"""Rotations between body axes (x forward, y right, z down) and stability axes (lift and drag)."""

from __future__ import annotations

from bayes_aero.arrays import Samples, xp


def lift_drag_from_body(CX: Samples, CZ: Samples, alpha: Samples) -> tuple[Samples, Samples]:
    """CL and CD from the body-axis force coefficients; `alpha` in rad.

    CL = CX sin alpha - CZ cos alpha, CD = -CX cos alpha - CZ sin alpha.
    """
    sin, cos = xp.sin(alpha), xp.cos(alpha)
    return CX * sin - CZ * cos, -CX * cos - CZ * sin


def body_from_lift_drag(CL: Samples, CD: Samples, alpha: Samples) -> tuple[Samples, Samples]:
    """CX and CZ from lift and drag; the inverse of `lift_drag_from_body`."""
    sin, cos = xp.sin(alpha), xp.cos(alpha)
    return CL * sin - CD * cos, -CL * cos - CD * sin
