"""Axes of an aircraft's motion: what a card may model."""

from __future__ import annotations

from enum import StrEnum


class Axis(StrEnum):
    """The plane of symmetry (CL, CD, Cm) or out of it (CY, Cl, Cn)."""

    LONGITUDINAL = "longitudinal"
    LATERAL = "lateral"
