"""Records of three-axis stalls, made backwards: the motion is prescribed, the controls are what it asks for.

Rates, flow angles and their derivatives are sums of sines; forces are those of the model, and elevator, aileron and
rudder balance its moments against the inertial ones, sample by sample (Newton). No equations of motion are integrated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from bayes_aero.effect import Effect, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.model.records import plain_marks
from bayes_aero.physics.aircraft import Axis
from bayes_aero.physics.coefficients import coefficients
from bayes_aero.physics.kinematics import Rotation, lever_arm
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.injection import misrecorded

BOTH = tuple(Axis)
DT, SAMPLES = 0.04, 1000
LATERAL_TRUTH = {
    "CY0": 0.02, "CYbe": -0.85, "CYdr": 0.2, "Cl0": 0.003, "Clbe": -0.11, "Clp": -0.42, "Clr": 0.12, "Clda": -0.15,
    "Cldr": 0.02, "Cn0": -0.003, "Cnbe": 0.14, "Cnp": -0.08, "Cnr": -0.2, "Cnda": 0.01, "Cndr": -0.1,
    "roll_station": 0.5,
}  # fmt: skip
CONTROLS = ("elevator", "aileron", "rudder")
NOISE = {"ax": 0.02, "ay": 0.02, "az": 0.02, "p": 5e-5, "q": 5e-5, "r": 5e-5, "alpha": 2e-4, "beta": 2e-4}
OWNERS = [e.name for e in CATALOGUE.values() if {p.name for p in e.parameters} & set(LATERAL_TRUTH)]


def three_axis_card() -> Card:
    """The shipped ATTAS card with lateral effects, engines that are recorded one by one, and nothing derived."""
    card = read_card("attas")
    aircraft = replace(card.aircraft, engine_arm=2.5)
    effects = tuple(dict.fromkeys((*card.effects, *OWNERS, "wing_lift_difference", "wing_drag_difference")))
    return replace(card, aircraft=aircraft, axes=BOTH, effects=effects, sums={}, constants={}, derived={}, tables={})


def motion(seed: int) -> dict[str, np.ndarray]:
    """What is prescribed: sums of sines, differentiated by hand."""
    rng, t = np.random.default_rng(seed), np.arange(SAMPLES) * DT

    def sines(size: float, slow: float, fast: float, count: int = 5):
        w, phase = rng.uniform(slow, fast, count), rng.uniform(0.0, 2.0 * np.pi, count)
        part = size / np.sqrt(count) * rng.uniform(0.6, 1.4, count)
        return (part[:, None] * np.sin(np.outer(w, t) + phase[:, None])).sum(0), (
            part[:, None] * w[:, None] * np.cos(np.outer(w, t) + phase[:, None])
        ).sum(0)

    found = {}
    for name, size, slow, fast in (("p", 0.15, 0.6, 3.0), ("q", 0.05, 0.6, 3.0), ("r", 0.06, 0.5, 2.5)):
        found[name], found[f"{name}_dot"] = sines(size, slow, fast)
    beta, _ = sines(0.06, 0.4, 2.0)
    swing, swing_dot = sines(0.05, 0.8, 2.0)
    slow = 0.2 - 0.1 * np.cos(2.0 * np.pi * t / 20.0)
    alpha_dot = 0.1 * 2.0 * np.pi / 20.0 * np.sin(2.0 * np.pi * t / 20.0) + swing_dot
    speed, _ = sines(8.0, 0.1, 0.5)
    height, _ = sines(60.0, 0.05, 0.3)
    left, right, spoilers = (sines(size, 0.2, 1.0)[0] for size in (1500.0, 1500.0, 0.08))
    canard, _ = sines(0.1, 0.5, 2.0)
    V = 85.0 + speed
    return found | {
        "alpha": slow + swing, "alpha_dot": alpha_dot, "beta": beta, "airspeed": V, "mach": V / 320.0,
        "density": 0.74 - 1e-4 * height, "altitude": 5000.0 + height, "thrust_left": 6000.0 + left,
        "thrust_right": 6000.0 + right, "thrust": 12000.0 + left + right, "spoiler_left": np.maximum(spoilers, 0.0),
        "spoiler_right": np.maximum(-spoilers, 0.0), "canard": canard,
    }  # fmt: skip


@cache
def lateral_effects() -> tuple[Effect, ...]:
    """Those of the card, and of the lateral axis and of a canard all through which these records may act."""
    have, on_card = {*motion(0), *CONTROLS, "ax", "ay", "az"}, three_axis_card().effects
    lateral = [e for e in CATALOGUE.values() if e.axes == (Axis.LATERAL,) or e.name.startswith("canard")]
    flown = [e for e in lateral if e.disturbance is None and set(e.channels) <= have]
    return tuple(e for e in CATALOGUE.values() if e in flown or e.name in on_card)


@cache
def models() -> tuple[Model, Model]:
    """What flies, and what misrecords: one model each, whatever is hidden."""
    channel = [e for e in lateral_effects() if e.stage is Stage.CHANNEL]
    return Model.of([e for e in lateral_effects() if e not in channel], axes=BOTH), Model.of(channel, axes=BOTH)


def values(hidden: Mapping[str, float]) -> dict[str, float]:
    """Every parameter of both models: neutral, the true aircraft's, what is hidden."""
    neutral = {p.name: p.neutral for model in models() for p in model.parameters}
    return neutral | TRUTH | {"tau2": 0.0} | LATERAL_TRUTH | dict(hidden)


@jax.jit
def _balanced(known, given, aircraft):
    """Controls that balance the moments, and the accelerations that go with the forces, (n, 3) each."""
    model = models()[0]
    marks = plain_marks(SAMPLES, DT, 0)

    def felt(controls):
        s = given | dict(zip(CONTROLS, controls.T, strict=True))
        flow = model.flow(known, s | marks, aircraft)
        CX = flow["CL"] * jnp.sin(s["alpha"]) - flow["CD"] * jnp.cos(s["alpha"])
        CZ = -flow["CL"] * jnp.cos(s["alpha"]) - flow["CD"] * jnp.sin(s["alpha"])
        force = 0.5 * s["density"] * s["airspeed"] ** 2 * aircraft.wing_area / aircraft.mass
        tilt = aircraft.engine_inclination
        push = s["thrust"] / aircraft.mass
        x, y, z = lever_arm(Rotation(*(s[k] for k in Rotation._fields)), aircraft.accelerometer)
        ax, az = force * CX + push * jnp.cos(tilt) + x, force * CZ - push * jnp.sin(tilt) + z
        return jnp.stack([ax, force * flow["CY"] + y, az], axis=1), flow, s

    def out_of_balance(controls):
        a, flow, s = felt(controls)
        there = coefficients(s | dict(zip(("ax", "ay", "az"), a.T, strict=True)), aircraft)
        return jnp.stack([flow[k] - there[k] for k in ("Cm", "Cl", "Cn")], axis=1)

    controls = jnp.zeros((SAMPLES, 3))
    for _ in range(4):
        columns = [
            jax.jvp(out_of_balance, (controls,), (jnp.zeros_like(controls).at[:, k].set(1.0),)) for k in range(3)
        ]
        slope = jnp.stack([column for _, column in columns], axis=2)
        controls = controls - jnp.linalg.solve(slope, columns[0][0][..., None])[..., 0]
    return controls, felt(controls)[0], jnp.max(jnp.abs(out_of_balance(controls)))


def flown(hidden: Mapping[str, float], seed: int) -> FlightRecord:
    """One record of the true aircraft with what is hidden in it."""
    card, v = three_axis_card(), values(hidden)
    given = motion(seed)
    known = {name: jnp.asarray(x, float) for name, x in v.items()}  # of one type, or each flight compiles anew
    aircraft = models()[0].actual_aircraft(known, card.aircraft)
    signals = {name: jnp.asarray(x) for name, x in given.items()}
    controls, felt, left = _balanced(known, signals, aircraft)
    assert float(left) < 1e-10
    names = (*CONTROLS, "ax", "ay", "az")
    true = given | dict(zip(names, np.concatenate([controls, felt], axis=1).T, strict=True))
    true = {name: np.asarray(x) for name, x in true.items() if not name.endswith("_dot")}
    recorded = misrecorded(models()[1], v, true, plain_marks(SAMPLES, DT, 0), card.aircraft)
    rng = np.random.default_rng([seed, 1])
    recorded = {k: x + NOISE.get(k, 0.0) * rng.standard_normal(SAMPLES) for k, x in recorded.items()}
    return FlightRecord.from_arrays(f"flight_{seed}", np.arange(SAMPLES) * DT, recorded, "simulated")
