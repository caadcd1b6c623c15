"""The aircraft of `stranger_six` under the catalogue's effects: its constants, its model, its record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from stranger_six import Plane

from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.axes import Axis
from bayes_aero.model.model import Model

BOTH = (Axis.LONGITUDINAL, Axis.LATERAL)
LONGITUDINAL = (
    "attached_lift", "elevator_lift", "profile_drag", "induced_drag", "pitching_moment", "pitch_damping",
    "elevator_moment",
)  # fmt: skip
LATERAL = (
    "sideslip_side_force", "yaw_rate_side_force", "rudder_side_force", "sideslip_roll", "roll_damping", "yaw_rate_roll",
    "aileron_roll", "rudder_roll", "sideslip_yaw", "roll_rate_yaw", "yaw_damping", "aileron_yaw", "rudder_yaw",
)  # fmt: skip
STALL = ("flow_separation", "kirchhoff_lift", "separated_drag", "separated_moment", "separation_lag")
ATTACHED = {"station": 0.0, "stalls": False}
"""Changes of a `Plane` to which the linear effects are the whole truth."""


def aircraft(plane: Plane) -> Aircraft:
    """Its constants."""
    return Aircraft(
        mass=plane.mass, Ix=plane.Ix, Iy=plane.Iy, Iz=plane.Iz, Ixz=plane.Ixz, wing_area=plane.S, chord=plane.c,
        half_span=plane.b / 2.0, aspect_ratio=plane.b**2 / plane.S, tail_arm=plane.tail, accelerometer=plane.nose,
        engine=(0.0, 0.0, plane.engine_drop), engine_arm=plane.engine_arm, Ixy=plane.Ixy, Iyz=plane.Iyz,
    )  # fmt: skip


def model(effects: Any = (*LONGITUDINAL, *LATERAL), axes: tuple[Axis, ...] = BOTH, **fixed: float) -> Model:
    """Of these effects."""
    return Model.of(effects, fixed, axes)


def values(plane: Plane, of: Model, **changes: float) -> dict[str, Any]:
    """What a model's parameters are on this aircraft; neutral where it does not know them."""
    found = {p.name: getattr(plane, p.name, p.neutral) for p in of.parameters}
    return {name: jnp.asarray(float(x)) for name, x in (found | changes).items()}


def channels(flight: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Inputs of a simulation."""
    return {name: jnp.asarray(flight[name]) for name in ("elevator", "aileron", "rudder", "thrust", "density")} | {
        name: jnp.asarray(flight[name]) for name in ("thrust_left", "thrust_right")
    }
