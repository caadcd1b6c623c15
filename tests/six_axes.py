"""The aircraft of `stranger_six` under the catalogue's effects: its constants, its model, its record."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from stranger_six import Plane

from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import Aircraft, Axis

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


NOISE = {
    "ax": 0.02, "ay": 0.02, "az": 0.05, "p": 3e-4, "q": 3e-4, "r": 3e-4, "phi": 5e-4, "theta": 5e-4, "psi": 5e-4,
    "alpha": 1e-3, "beta": 1e-3, "airspeed": 0.1, "altitude": 1.0,
    "elevator": 1e-5, "aileron": 1e-5, "rudder": 1e-5,
}  # fmt: skip
"""Standard deviations of the recorder's white noise, SI."""
UNITS = {"time": "s", "airspeed": "m/s", "altitude": "m", "density": "kg/m^3"}
RECORDED = (*NOISE, "thrust_left", "thrust_right", "density")


def unit(channel: str) -> str:
    """SI unit of a channel of the record."""
    by_kind = {"a": "m/s^2"} if channel in ("ax", "ay", "az") else {"p": "rad/s", "q": "rad/s", "r": "rad/s"}
    usual = "N" if channel.startswith("thrust") else "rad"
    return UNITS.get(channel, by_kind.get(channel[0] if len(channel) < 3 else "", usual))


def card_in(folder: Path, plane: Plane, *options: Any) -> Card:
    """The card of `card_text`, read from a folder."""
    (folder / "plane.toml").write_text(card_text(plane, *options), encoding="utf-8")
    return read_card(str(folder / "plane.toml"))


def card_text(plane: Plane, effects: Any = (*LONGITUDINAL, *LATERAL), axes: Any = BOTH, more: str = "") -> str:
    """A card of this aircraft whose record has SI units and the channels' own names."""
    inertia = "\n".join(f'{name} = "{getattr(plane, name)} kg m^2"' for name in ("Ix", "Iy", "Iz", "Ixz"))
    mapped = "\n".join(f'{n} = {{ label = "{n}", unit = "{unit(n)}" }}' for n in ("time", *RECORDED))
    sensors = "\n".join(f'{name} = "{x} {unit(name)}"' for name, x in NOISE.items())
    nose = ", ".join(f'"{x} m"' for x in plane.nose)
    return f"""
title = "another aircraft"
[aircraft]
mass = "{plane.mass} kg"
{inertia}
wing_area = "{plane.S} m^2"
chord = "{plane.c} m"
span = "{plane.b} m"
tail_arm = "{plane.tail} m"
accelerometer = [{nose}]
engine = ["0 m", "0 m", "{plane.engine_drop} m"]
engine_arm = "{plane.engine_arm} m"
[channels]
{mapped}
[sums]
thrust = ["thrust_left", "thrust_right"]
[sensors]
{sensors}
[model]
axes = {[str(axis) for axis in axes]}
effects = {list(effects)}
{more}
"""


def recorded(flight: Mapping[str, np.ndarray], rng: np.random.Generator) -> dict[str, np.ndarray]:
    """The channels of the card, with noise, and `time`."""
    n = len(flight["time"])
    return {c: flight[c] + NOISE.get(c, 0.0) * rng.standard_normal(n) for c in ("time", *RECORDED)}


def record(name: str, flight: Mapping[str, np.ndarray], rng: np.random.Generator) -> FlightRecord:
    """The recorded manoeuvre, noise included."""
    shown = recorded(flight, rng)
    thrust = shown["thrust_left"] + shown["thrust_right"]
    channels = {n: x for n, x in shown.items() if n != "time"} | {"thrust": thrust}
    return FlightRecord.from_arrays(name, shown["time"], channels, "simulated")
