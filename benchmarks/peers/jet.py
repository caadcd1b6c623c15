"""Output error of a small jet, phugoid and short period: ours, SciPy over a NumPy simulation, and aeroid 0.5.

600 samples, 4 states, 6 outputs, 11 parameters, all from one start that is wrong by up to 15 %. Priors are flat, for
aeroid has none. Peers are given the weights of the optimum, and aeroid the initial state, too; ours has to find both.
Judged by (n/2) log det R in one simulation.
"""

from __future__ import annotations

import argparse
import pickle
import tomllib
from collections.abc import Callable
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from contender import Problem

if TYPE_CHECKING:
    import aeroid

    from bayes_aero.inference.output_error import OutputErrorResult

JET = "jet.pickle"

CARD = """
title = "A small jet, phugoid and short period"
[aircraft] # the tailplane so far away that its lift is nothing
mass = "7472 kg"
Ix = "19000 kg m^2"
Iy = "59748 kg m^2"
Iz = "75000 kg m^2"
Ixz = "0 kg m^2"
wing_area = "30.1 m^2"
chord = "2.43 m"
half_span = "7.25 m"
aspect_ratio = 6.0
tail_arm = "1e12 m"
engine = ["0 m", "0 m", "0.53 m"]
engine_inclination = "3 deg"
reference_speed = "104.67 m/s"
rate_length = "1.215 m"
[channels]
time = { label = "t", unit = "s" }
airspeed = { label = "V", unit = "m/s" }
alpha = { label = "alpha", unit = "rad" }
theta = { label = "theta", unit = "rad" }
q = { label = "q", unit = "rad/s" }
ax = { label = "ax", unit = "m/s^2" }
az = { label = "az", unit = "m/s^2" }
elevator = { label = "de", unit = "rad" }
thrust = { label = "T", unit = "N" }
[constants]
density = "0.792 kg/m^3"
[model]
effects = [
  "profile_drag", "speed_drag", "alpha_drag", "attached_lift", "speed_lift",
  "pitching_moment", "speed_moment", "pitch_damping", "elevator_moment",
]
"""
VALUES = {
    "CD0": 0.12, "CDV": -0.065, "CDa": 0.32, "CL0": -0.09, "CLV": 0.15, "CLa": 4.3,
    "Cm0": 0.11, "CmV": 0.004, "Cma": -0.97, "Cmq": -34.0, "Cmde": -1.5,
}  # fmt: skip
SENSORS = {"airspeed": 0.2, "alpha": 0.002, "theta": 0.002, "q": 0.001, "ax": 0.03, "az": 0.1}
STATES = ("airspeed", "alpha", "theta", "q")
OUTPUTS = (*STATES, "ax", "az")
N, DT = 600, 0.1
FLAT = 1e4  # deviation of the priors


@dataclass(frozen=True)
class Jet:
    """What aeroid is given, in plain NumPy; arrays of parameters follow `names`."""

    time: np.ndarray
    channels: dict[str, np.ndarray]
    names: tuple[str, ...]
    start: np.ndarray
    estimate: np.ndarray
    begin: np.ndarray  # initial state at the optimum, (4,)
    sigma: dict[str, float]  # deviations of the outputs' residuals there
    aircraft: SimpleNamespace
    gravity: float


class Found(NamedTuple):
    """Parameters and initial state of a fit."""

    theta: np.ndarray
    begin: np.ndarray


def flown_jet():
    """The record, made by our own simulator with noise, as a segment to fit; and the aircraft."""
    import jax
    import jax.numpy as jnp

    from bayes_aero.dynamics.flight import aircraft_dynamics
    from bayes_aero.dynamics.segments import segments
    from bayes_aero.dynamics.system import integrate
    from bayes_aero.flight.card import parse_card
    from bayes_aero.flight.record import FlightRecord
    from bayes_aero.model.model import Model
    from bayes_aero.model.observations import join
    from bayes_aero.parameter import Prior

    card = parse_card(tomllib.loads(CARD), "jet", "jet.toml")
    t = np.arange(N) * DT
    elevator = 0.003 + 0.015 * np.select([t < 2, t < 5, t < 7, t < 8, t < 9], [0, 1, -1, 1, -1], 0.0)
    elevator[(t > 20) & (t < 22)] -= 0.02
    thrust = np.where(t < 35, 12400.0, 11400.0)
    begin = jnp.asarray([104.67, 0.1166, 0.1166, 0.0])
    channels = dict.fromkeys(("ax", "az"), np.zeros(N)) | dict(zip(STATES, np.ones((4, N)), strict=True))
    channels |= {"elevator": elevator, "thrust": thrust}
    dynamics = aircraft_dynamics(Model.from_card(card), join([FlightRecord.from_arrays("jet", t, channels)], card, ()))
    wide = [replace(p, prior=Prior("normal", p.start, FLAT)) for p in dynamics.model.parameters]
    dynamics = replace(dynamics, model=replace(dynamics.model, parameters=tuple(wide)))
    assert dynamics.states == STATES
    assert set(dynamics.names) == set(VALUES)
    system = dynamics.system({name: jnp.asarray(x) for name, x in VALUES.items()}, card.aircraft)
    drives = {k: jnp.asarray(channels[k]) for k in ("elevator", "thrust")} | {"density": jnp.full(N, 0.792)}
    flight = jax.jit(integrate, static_argnums=4)(system, begin, drives, DT, 1)
    rng = np.random.default_rng(11)
    channels |= {k: np.asarray(flight.outputs[k]) + sd * rng.standard_normal(N) for k, sd in SENSORS.items()}
    flights = join([FlightRecord.from_arrays("jet", t, channels)], card, ())
    return segments(flights, aircraft_dynamics(dynamics.model, flights)), card.aircraft


def wrong_start(names):
    """The truth, each value wrong by up to 15 %."""
    rng = np.random.default_rng(5)
    return np.array([VALUES[name] * (1.0 + rng.uniform(-0.15, 0.15)) for name in names])


def numpy_response(jet: Jet, theta: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """Outputs (6, N, m) for m columns of parameters (k, m) and initial states (4, m) at once."""
    v, a = dict(zip(jet.names, theta, strict=True)), jet.aircraft
    elevator, thrust = jet.channels["elevator"], jet.channels["thrust"]
    half, V0, length = 0.5 * 0.792 * a.wing_area, a.reference_speed, a.rate_length
    tx, tz, arm = np.cos(a.engine_inclination), -np.sin(a.engine_inclination), a.engine[2]

    def motion(x, de, T):
        V, alpha, pitch, q = x
        sin, cos, ratio = np.sin(alpha), np.cos(alpha), V / V0
        CL = v["CL0"] + v["CLV"] * ratio + v["CLa"] * alpha
        CD = v["CD0"] + v["CDV"] * ratio + v["CDa"] * alpha
        Cm = v["Cm0"] + v["CmV"] * ratio + v["Cma"] * alpha + v["Cmq"] * q * (length / V0) + v["Cmde"] * de
        force = half * V * V
        ax = (force * (CL * sin - CD * cos) + T * tx) / a.mass
        az = (force * (-CL * cos - CD * sin) + T * tz) / a.mass
        gx, gz = ax - jet.gravity * np.sin(pitch), az + jet.gravity * np.cos(pitch)
        q_dot = (force * a.chord * Cm + T * (tx * arm)) / a.Iy
        return np.array([gx * cos + gz * sin, q + (gz * cos - gx * sin) / V, q, q_dot]), ax, az

    x, found = np.array(begin), np.empty((6, N, *np.shape(begin)[1:]))
    for i in range(N):
        k1, ax, az = motion(x, elevator[i], thrust[i])
        found[:4, i], found[4, i], found[5, i] = x, ax, az
        if i + 1 < N:
            de, T = 0.5 * (elevator[i] + elevator[i + 1]), 0.5 * (thrust[i] + thrust[i + 1])
            k2, _, _ = motion(x + 0.5 * DT * k1, de, T)
            k3, _, _ = motion(x + 0.5 * DT * k2, de, T)
            k4, _, _ = motion(x + DT * k3, elevator[i + 1], thrust[i + 1])
            x = x + DT / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return found


def prepare_jet(folder: Path) -> None:
    """Simulate the record, fit it and put it into `folder`."""
    import jax.numpy as jnp

    from bayes_aero.inference.output_error import trajectories
    from bayes_aero.physics.aircraft import GRAVITY

    flown, aircraft = flown_jet()
    fit = our_fit(flown)
    order = [flown.outputs.index(name) for name in OUTPUTS]
    found = trajectories(flown, jnp.asarray(fit.estimate), jnp.asarray(fit.departure)).trajectory
    constants = ("mass", "Iy", "wing_area", "chord", "engine", "engine_inclination", "reference_speed", "rate_length")
    jet = Jet(
        time=np.arange(N) * DT,
        channels={name: np.asarray(flown.flights.channels[name]) for name in (*OUTPUTS, "elevator", "thrust")},
        names=fit.names,
        start=wrong_start(fit.names),
        estimate=fit.estimate,
        begin=np.asarray(found.states)[0, 0],
        sigma=dict(zip(OUTPUTS, np.sqrt(fit.R[order]).tolist(), strict=True)),
        aircraft=SimpleNamespace(**{name: plain(getattr(aircraft, name)) for name in constants}),
        gravity=GRAVITY,
    )
    apart = np.max(np.abs(np.asarray(found.states)[0].T - numpy_response(jet, jet.estimate, jet.begin)[:4]))
    assert apart < 1e-8, apart
    (folder / JET).write_bytes(pickle.dumps(jet))


def plain(value):
    """A number, or a tuple of them."""
    return tuple(map(float, value)) if isinstance(value, tuple) else float(value)


def our_fit(flown) -> OutputErrorResult:
    """From the wrong start."""
    from bayes_aero.inference.output_error import fit_output_error

    return fit_output_error(flown, start=wrong_start(flown.dynamics.names))


def jet_of(problem: Problem) -> Jet:
    """What `prepare_jet` has left."""
    return pickle.loads((problem.folder / JET).read_bytes())


def ours(problem: Problem, _: int, __: argparse.Namespace) -> Callable[[int], Found]:
    """Parameters, initial state and covariance of the noise."""
    flown, _ = flown_jet()
    begin = jet_of(problem).begin

    def run(_: int) -> Found:
        return Found(our_fit(flown).estimate, begin)  # whose initial state is its own optimum, too

    return run


def scipy_with(method: str) -> Callable[[Problem, int, argparse.Namespace], Callable[[int], Found]]:
    """scipy.optimize.least_squares over parameters and initial state, with its own differences."""

    def prepared(problem: Problem, _: int, __: argparse.Namespace) -> Callable[[int], Found]:
        from scipy.optimize import least_squares

        jet, k = jet_of(problem), len(VALUES)
        measured = np.stack([jet.channels[name] for name in OUTPUTS])
        weight = 1.0 / np.array([jet.sigma[name] for name in OUTPUTS])[:, None]

        def residual(x: np.ndarray) -> np.ndarray:
            return ((measured - numpy_response(jet, x[:k], x[k:])) * weight).ravel()

        def run(_: int) -> Found:
            x = least_squares(residual, np.append(jet.start, measured[:4, 0]), x_scale="jac", method=method).x
            return Found(x[:k], x[k:])

        return run

    return prepared


def jet_model(xp, aircraft, gravity, parameters):
    """aeroid's model; `xp` is NumPy for its differences, jax.numpy for its exact gradient. SI."""
    import aeroid

    a, half = aircraft, 0.5 * 0.792 * aircraft.wing_area

    def forces(x, u, v):
        V, alpha, q = x[0], x[1], x[3]
        sin, cos, ratio = xp.sin(alpha), xp.cos(alpha), V / a.reference_speed
        CL = v["CL0"] + v["CLV"] * ratio + v["CLa"] * alpha
        CD = v["CD0"] + v["CDV"] * ratio + v["CDa"] * alpha
        Cm = v["Cm0"] + v["CmV"] * ratio + v["Cma"] * alpha
        Cm = Cm + v["Cmq"] * q * (a.rate_length / a.reference_speed) + v["Cmde"] * u[0]
        force, tilt = half * V * V, a.engine_inclination
        ax = (force * (CL * sin - CD * cos) + u[1] * np.cos(tilt)) / a.mass
        az = (force * (-CL * cos - CD * sin) - u[1] * np.sin(tilt)) / a.mass
        return ax, az, (force * a.chord * Cm + u[1] * (np.cos(tilt) * a.engine[2])) / a.Iy

    def dynamics(t, x, u, v):  # noqa: ARG001
        V, alpha, pitch, q = x[0], x[1], x[2], x[3]
        ax, az, q_dot = forces(x, u, v)
        gx, gz = ax - gravity * xp.sin(pitch), az + gravity * xp.cos(pitch)
        V_dot = gx * xp.cos(alpha) + gz * xp.sin(alpha)
        alpha_dot = q + (gz * xp.cos(alpha) - gx * xp.sin(alpha)) / xp.maximum(V, 1.0)  # it is tried at V = 0
        return xp.array([V_dot, alpha_dot, q, q_dot])

    def measured(t, x, u, v):  # noqa: ARG001
        ax, az, _ = forces(x, u, v)
        return xp.array([x[0], x[1], x[2], x[3], ax, az])

    names = [f"x_{name}" for name in STATES]
    return aeroid.Model(names, ["elevator", "thrust"], parameters, dynamics, OUTPUTS, measured)


class KeptRollout:
    """aeroid's compiled simulation of one problem, kept; aeroid itself compiles anew in every call."""

    def __init__(self):
        self.made = None

    @contextmanager
    def __call__(self):
        """While it lasts, aeroid gets what it made before."""
        from aeroid import autodiff

        plain = autodiff._JaxRollout

        def kept(*positional, **named):
            self.made = self.made or plain(*positional, **named)
            return self.made

        autodiff._JaxRollout = kept
        try:
            yield
        finally:
            autodiff._JaxRollout = plain


def aeroid_problem(jet: Jet, how: str) -> tuple[aeroid.Model, aeroid.FlightData]:
    """Model and data; `how` is "fd" or "jax"."""
    import aeroid

    xp = np
    if how == "jax":
        import jax
        import jax.numpy as xp

        jax.config.update("jax_enable_x64", True)
    parameters = dict(zip(jet.names, map(float, jet.start), strict=True))
    model = jet_model(xp, jet.aircraft, jet.gravity, parameters)
    return model, aeroid.FlightData(jet.time, jet.channels)


def aeroid_with(how: str, kept: bool = False) -> Callable[[Problem, int, argparse.Namespace], Callable[[int], Found]]:
    """aeroid.identify, with its differences or JAX's gradient, which it compiles in every call unless it is `kept`."""

    def prepared(problem: Problem, _: int, __: argparse.Namespace) -> Callable[[int], Found]:
        import aeroid

        jet = jet_of(problem)
        model, data = aeroid_problem(jet, how)
        held = KeptRollout() if kept else nullcontext
        weights = {name: 1.0 / sigma for name, sigma in jet.sigma.items()}

        def run(_: int) -> Found:
            with held():
                found = aeroid.identify(model, data, list(jet.names), gradient=how, weights=weights, x0=jet.begin)
            return Found(np.array([found.parameters[name] for name in jet.names]), jet.begin)

        return run

    return prepared


def judge(problem: Problem, _: int, warm: list[tuple[float, Found]]) -> dict[str, float]:
    """The cost reached, nats."""
    jet, (theta, begin) = jet_of(problem), warm[-1][1]
    measured = np.stack([jet.channels[name] for name in OUTPUTS])
    R = np.mean((measured - numpy_response(jet, theta, begin)) ** 2, axis=1)
    return {"cost": float(0.5 * measured.shape[1] * np.sum(np.log(R)))}


CONTENDERS = {
    "bayes_aero": ours,
    "scipy least_squares, trf": scipy_with("trf"),
    "scipy least_squares, lm": scipy_with("lm"),
    "aeroid, its differences": aeroid_with("fd"),
    "aeroid, JAX gradient": aeroid_with("jax"),
    "the same, kept compiled by us": aeroid_with("jax", kept=True),
}
