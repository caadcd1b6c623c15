"""Linear effects of all six coefficients, each with one parameter, and the aircraft that they make: for tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.flight.axes import Axis
from bayes_aero.model.model import Model
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.physics.rates import reduced, reduced_lateral

AIRCRAFT = Aircraft(
    mass=17600.0, Ix=140e3, Iy=330e3, Iz=430e3, Ixz=20e3, wing_area=64.0, chord=3.16, half_span=10.75, aspect_ratio=7.22,
    tail_arm=10.0, reference_point=(0.1, 0.0, -0.05), accelerometer=(1.5, 0.2, -0.4), engine=(-1.3, 0.0, 0.6),
    engine_inclination=0.02, Ixy=1e3, Iyz=-2e3,
)  # fmt: skip
"""Round numbers near a small jet transport, products of inertia and lever arms all different from zero."""

FORMS: Mapping[str, tuple[str, Callable[..., Any]]] = {
    "0": ("alpha", lambda s, a: jnp.ones_like(s["alpha"])),
    "a": ("alpha", lambda s, a: s["alpha"]),
    "aa": ("alpha", lambda s, a: s["alpha"] ** 2),
    "q": ("q", lambda s, a: reduced(s["q"], s["airspeed"], a)),
    "ad": ("alpha_dot", lambda s, a: reduced(s["alpha_dot"], s["airspeed"], a)),
    "de": ("elevator", lambda s, a: s["elevator"]),
    "b": ("beta", lambda s, a: s["beta"]),
    "p": ("p", lambda s, a: reduced_lateral(s["p"], s["airspeed"], a)),
    "r": ("r", lambda s, a: reduced_lateral(s["r"], s["airspeed"], a)),
    "da": ("aileron", lambda s, a: s["aileron"]),
    "dr": ("rudder", lambda s, a: s["rudder"]),
}

LONGITUDINAL = {
    "CL0": 0.15, "CLa": 5.0, "CLde": 0.4, "CD0": 0.035, "CDaa": 1.1,
    "Cm0": 0.06, "Cma": -0.9, "Cmq": -14.0, "Cmde": -1.3,
}  # fmt: skip
LATERAL = {
    "CYb": -0.75, "CYr": 0.3, "CYdr": 0.2, "Clb": -0.11, "Clp": -0.48, "Clr": 0.16, "Clda": -0.14, "Cldr": 0.02,
    "Cnb": 0.13, "Cnp": -0.05, "Cnr": -0.19, "Cnda": 0.01, "Cndr": -0.10,
}  # fmt: skip
TRUTH = LONGITUDINAL | LATERAL
BOTH = (Axis.LONGITUDINAL, Axis.LATERAL)


def effect(name: str) -> Effect:
    """The effect of one derivative, e.g. Clda: coefficient Cl by `FORMS["da"]`."""
    coefficient, (channel, form) = name[:2], FORMS[name[2:]]
    key = "CL_attached" if coefficient == "CL" else coefficient

    def increments(v, s, a, known):  # noqa: ARG001
        return {key: v[name] * form(s, a)}

    start = 0.5 * TRUTH.get(name, 0.0)
    parameter = Parameter(name, "1", 0.0, start, name, Prior("normal", 0.0, 100.0, "flat in effect"))
    none = Example({}, {}, {}, "none")
    stage = Stage.ATTACHED if coefficient == "CL" else Stage.TOTAL
    return Effect(name, Kind.AERODYNAMICS, stage, name, (parameter,), (channel,), increments, none, "linear")


EFFECTS = {name: effect(name) for name in (*TRUTH, "CLad", "Cmad")}


def model(names: Any = tuple(TRUTH), axes: tuple[Axis, ...] = BOTH) -> Model:
    """Of these derivatives."""
    return Model.of([EFFECTS[name] for name in names], axes=axes)


def values(**changes: float) -> dict[str, Any]:
    """The true ones."""
    return {name: jnp.asarray(x) for name, x in (TRUTH | changes).items()}
