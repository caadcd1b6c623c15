"""Output error against scipy.optimize.least_squares over a NumPy simulation, and our simulation against a bare scan.

    OPENBLAS_NUM_THREADS=1 python benchmarks/output_error_speed.py [--repeats 5]

First: 600 samples of phugoid and short period, 4 states, 11 linear aerodynamic parameters, both from the same start.
least_squares gets the residual covariance of the optimum as weights, which our fit has to find; so does aeroid 0.5
(where installed), with the initial state too. Priors are flat, for aeroid has none. Second: simulation and Jacobian of
one stall manoeuvre, against the same equations written down for this one case. Compilation comes before the clock;
every pair is first shown to compute the same. Times are the best of several runs, taken in turn, for each contestant.
"""

import argparse
import time
import tomllib
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from aeroid_jet import KeptRollout, jet_model
from bare_stall import bare_jacobian
from scipy.optimize import least_squares

from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.segments import segments, simulate
from bayes_aero.dynamics.system import integrate
from bayes_aero.flight.card.card import parse_card, read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.output_error import fit_output_error, trajectories
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.parameter import Prior
from bayes_aero.physics.atmosphere import GRAVITY
from bayes_aero.simulate.demo import TRUTH, simulate_stall

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
N, DT = 600, 0.1
FLAT = 1e4  # deviation of the priors
NEAR = 2e-2  # Cramer-Rao deviations: how near both must end
EXACT = {"rtol": 1e-9, "atol": 1e-11, "max_step": DT}  # lest a peer's integrator step over the inputs' kinks


def problem():
    """The record, made by our own simulator with noise, as a segment to fit."""
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


def numpy_response(theta, begin, names, aircraft, elevator, thrust):
    """Outputs (6, N, m) for m columns of parameters (k, m) and initial states (4, m) at once."""
    v, a = dict(zip(names, theta, strict=True)), aircraft
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
        gx, gz = ax - GRAVITY * np.sin(pitch), az + GRAVITY * np.cos(pitch)
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


class Reference:
    """Weighted residuals of measurements and priors over parameters and departures of the initial state (k + 4)."""

    def __init__(self, flown, aircraft, best):
        self.names, self.k, self.priors = best.names, len(best.names), best.priors
        channels = {name: np.asarray(x) for name, x in flown.flights.channels.items()}
        self.measured = np.stack([channels[name] for name in (*STATES, "ax", "az")])
        order = [flown.outputs.index(name) for name in (*STATES, "ax", "az")]
        self.weight = 1.0 / np.sqrt(best.R[order])
        nothing = trajectories(flown, jnp.asarray(best.estimate), jnp.zeros((1, 4)))
        self.begin = np.asarray(nothing.trajectory.states)[0, 0]
        self.respond = partial(
            numpy_response, names=best.names, aircraft=aircraft, elevator=channels["elevator"],
            thrust=channels["thrust"],
        )  # fmt: skip

    def outputs(self, x):
        """(6, N, ...) of one vector (k + 4,) or of several columns (k + 4, m)."""
        begin = self.begin.reshape(4, *[1] * (x.ndim - 1)) + x[self.k :]
        return self.respond(x[: self.k], begin)

    def residual(self, x):
        fit = ((self.measured - self.outputs(x)) * self.weight[:, None]).ravel()
        held = np.sqrt(self.priors.precision) * (x[: self.k] - self.priors.mean)
        return np.concatenate([fit, held, np.sqrt(self.priors.states) * x[self.k :]])

    def jacobian(self, x):
        """Forward differences, all columns in one simulation."""
        step = 1e-7 * np.maximum(1.0, np.abs(x))
        found = self.outputs(np.concatenate([x[:, None], x[:, None] + np.diag(step)], axis=1))
        slope = -(found[:, :, 1:] - found[:, :, :1]) / step * self.weight[:, None, None]
        own = np.diag(np.concatenate([np.sqrt(self.priors.precision), np.sqrt(self.priors.states)]))
        return np.concatenate([slope.reshape(-1, len(x)), own])


@eqx.filter_jit
def sensitivities(flown, theta, departure):
    """Minus the derivative of the residuals with respect to parameters and initial state: (w, n, c, k + s)."""
    k, s = theta.shape[0], departure.shape[1]
    towards = (jnp.concatenate([jnp.eye(k), jnp.zeros((s, k))]), jnp.concatenate([jnp.zeros((k, s)), jnp.eye(s)]))

    def residual(a, b):
        return simulate(flown, a, departure + b).residual

    slope = jax.vmap(lambda t: jax.jvp(residual, (theta, jnp.zeros(s)), t)[1], out_axes=3)(towards)
    return -slope


def aeroid_runs(reference, flown, aircraft, start, best):
    """The peer on the same record: initial state given at the optimum, weights too, so it has less to find.

    Its exact gradient needs dynamics in jax.numpy, its differences the same in NumPy. Where it is not installed: none.
    """
    try:
        import aeroid
    except ImportError:
        print("aeroid is not installed (bench extra): its rows are left out")
        return {}
    channels = {name: np.asarray(x) for name, x in flown.flights.channels.items()}
    kept = (*STATES, "ax", "az", "elevator", "thrust")
    data = aeroid.FlightData(np.arange(N) * DT, {name: channels[name] for name in kept})
    weights = dict(zip((*STATES, "ax", "az"), map(float, reference.weight), strict=True))
    options = {"weights": weights, "x0": reference.begin + best.departure[0]}

    parameters = dict(zip(best.names, map(float, start), strict=True))
    models = {xp: jet_model(xp, aircraft, GRAVITY, STATES, parameters) for xp in (np, jnp)}

    def run(xp, gradient):
        solver = {} if gradient == "jax" else {"simulate_options": EXACT}
        found = aeroid.identify(models[xp], data, list(best.names), gradient=gradient, **solver, **options)
        off = max(
            abs(found.parameters[n] - x) / sd for n, x, sd in zip(best.names, best.estimate, best.crb, strict=True)
        )
        assert off < NEAR, off
        return off

    rollout = KeptRollout()

    def warm():
        with rollout():
            return run(jnp, "jax")

    for name, ends in (("differences", run(np, "fd")), ("JAX gradient", run(jnp, "jax")), ("the same, kept", warm())):
        print(f"aeroid, {name}: ends {ends:.4f} Cramer-Rao deviations from our optimum")
    return {
        "aeroid, its differences": lambda: run(np, "fd"),
        "aeroid, its JAX gradient (compiles each time)": lambda: run(jnp, "jax"),
        "aeroid, the same, kept compiled by us": warm,
    }


def timed(runs, repeats):
    """Least seconds of each, taken in turn so that a slow moment of the machine falls on all.

    Each runs once untimed in its turn: else the shortest pays for the caches and the memory that the longest left.
    """
    times = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            run()
            began = time.perf_counter()
            run()
            times[name].append(time.perf_counter() - began)
    return {name: min(taken) for name, taken in times.items()}


def told(times):
    """One line each, with the ratio to the first."""
    first = next(iter(times.values()))
    for name, seconds in times.items():
        print(f"  {name:46s} {1e3 * seconds:9.1f} ms  {seconds / first:7.2f} x")


def fits(repeats):
    """Phugoid and short period."""
    flown, aircraft = problem()
    names = flown.dynamics.names
    start = wrong_start(names)
    best = fit_output_error(flown, start=start)
    assert best.status is OutputErrorStatus.CONVERGED, best.status
    reference = Reference(flown, aircraft, best)
    x0, end = np.append(start, np.zeros(4)), np.append(best.estimate, best.departure[0])
    ours = np.asarray(trajectories(flown, jnp.asarray(best.estimate), jnp.asarray(best.departure)).trajectory.states)[0]
    apart = np.max(np.abs(ours.T - reference.outputs(end)[:4]))
    assert apart < 1e-8, apart

    def solve(**options):
        found = least_squares(reference.residual, x0, x_scale="jac", **options)
        off = np.max(np.abs(found.x[: len(names)] - best.estimate) / best.crb)
        assert off < NEAR, off
        return found

    off = solve().x
    print(f"{N} samples, 4 states, {len(names)} parameters, 6 outputs; simulations {apart:.0e} apart, optima within")
    print(f"{np.max(np.abs(off[: len(names)] - best.estimate) / best.crb):.0e} Cramer-Rao deviations")
    told(
        timed(
            {
                "bayes_aero, fit": lambda: fit_output_error(flown, start=start),
                "least_squares, its own differences, trf": solve,
                "least_squares, its own differences, lm": partial(solve, method="lm"),
                "least_squares, all differences at once, trf": partial(solve, jac=reference.jacobian),
            },
            repeats,
        )
    )
    peers = aeroid_runs(reference, flown, aircraft, start, best)
    if peers:
        told(timed({"bayes_aero, fit": lambda: fit_output_error(flown, start=start)} | peers, repeats))


def stall(repeats):
    """Simulation and Jacobian of one stall manoeuvre."""
    card = read_card("attas")
    flights = join([simulate_stall(0, card=card, sensor_noise=0.0, disturbance=0.0)], card)
    dynamics = aircraft_dynamics(Model.from_card(card), flights)
    flown = segments(flights, dynamics)
    theta, still = jnp.asarray([TRUTH[name] for name in dynamics.names]), jnp.zeros((1, 5))
    found = trajectories(flown, theta, still).trajectory
    assert bool(np.all(found.inside))
    drives = dynamics.drives(dynamics.values(theta), flights.channels, flights)
    bare = jax.jit(partial(bare_jacobian, dynamics.names, card.aircraft, flown.outputs))
    arguments = (theta, found.states[0, 0], drives, float(flown.dt[0]))
    S, ours = np.asarray(bare(*arguments)[1]), np.asarray(sensitivities(flown, theta, still))[0]
    size = np.max(np.abs(ours), axis=0)
    apart = np.max(np.abs(S - ours) / np.where(size > 0.0, size, 1.0))  # altitude moves nothing but itself
    assert apart < 1e-6, apart
    print(
        f"one stall manoeuvre, {flights.n} samples, {theta.size} parameters and 5 initial states, {S.shape[1]} outputs"
    )
    print(f"Jacobians {apart:.0e} apart, relative")
    told(
        timed(
            {
                "bare scan": lambda: jax.block_until_ready(bare(*arguments)),
                "bayes_aero": lambda: jax.block_until_ready(sensitivities(flown, theta, still)),
            },
            max(5, repeats),
        )
    )


def main():
    """Both parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    fits(options.repeats)
    stall(options.repeats)


if __name__ == "__main__":
    main()
