"""Six degrees of freedom: simulation with sensitivities against a bare scan of the same equations, and a fit, warm.

    OPENBLAS_NUM_THREADS=1 python benchmarks/rigid_body_speed.py

Three simulated manoeuvres of `full_six` (3-2-1-1, doublets of aileron and rudder). The bare scan is Runge and Kutta's
step written out, and its forward derivative by JAX in all directions. Both in turn, best of `REPEATS`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bayes_aero.dynamics.aircraft.gusts import FLOW
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, prepare, segments, simulate
from bayes_aero.dynamics.tangent import later
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card.card import read_card
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.simulate.request import Request
from bayes_aero.simulate.synthetic_record import synthetic

KINDS, SECONDS, REPEATS = ("elevator_3211", "aileron_doublet", "rudder_doublet"), 28.0, 7


def best(call: Callable[[], Any]) -> float:
    """Seconds of the fastest of some calls."""
    jax.block_until_ready(call())
    found = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        jax.block_until_ready(call())
        found.append(time.perf_counter() - begin)
    return min(found)


def step(system: Any, x: Any, now: Any, then: Any, dt: Any) -> Any:
    """Of Runge and Kutta."""
    middle = {name: 0.5 * (now[name] + then[name]) for name in now}
    k1 = system.motion(x, now)[0]
    k2 = system.motion(x + 0.5 * dt * k1, middle)[0]
    k3 = system.motion(x + 0.5 * dt * k2, middle)[0]
    return x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + system.motion(x + dt * k3, then)[0])


@eqx.filter_jit
def bare(flown: SegmentTrajectories, theta: Any) -> Any:
    """Outputs' derivatives by parameters and initial states."""
    prepared, dynamics, k = prepare(flown, theta), flown.dynamics, len(theta)

    def outputs(z):
        system = dynamics.system(dynamics.values(z[:k]), flown.flights.aircraft)

        def one(start, inputs, dt):
            def further(x, rows):
                found = system.motion(x, rows[0])[1]
                return step(system, x, rows[0], rows[1], dt), jnp.stack([found[name] for name in flown.outputs])

            return jax.lax.scan(further, system.state_at_start(start + z[k:]), (inputs, later(inputs)))[1]

        return jax.vmap(one)(prepared.begin, prepared.drives, jnp.asarray(flown.dt))

    return jax.jacfwd(outputs)(jnp.concatenate([theta, jnp.zeros(len(dynamics.start))]))


@eqx.filter_jit
def ours(flown: SegmentTrajectories, theta: Any) -> Any:
    """The same, of residuals."""
    k, s = len(theta), len(flown.dynamics.start)
    away = jnp.zeros((len(flown.index), s))
    residual = lambda theta, shared: simulate(flown, theta, away + shared).residual  # noqa: E731
    along = lambda t: jax.jvp(residual, (theta, jnp.zeros(s)), (t[:k], t[k:]))[1]  # noqa: E731
    return jax.vmap(along, out_axes=-1)(jnp.eye(k + s))


def main() -> None:
    """Print both."""
    card = read_card("full_six")
    records, truth = [], {}
    for seed, kind in enumerate(KINDS):
        asked = Request({}, kind, "white", seed=seed, duration=SECONDS)
        made = synthetic(asked, card, CATALOGUE, kind)
        records.append(made.record)
        truth |= made.parameters
    flights = join(records, card, ())
    dynamics = aircraft_dynamics(Model.from_card(card), flights)
    cut = segments(
        flights, dynamics, outputs=tuple(n for n in dynamics.outputs if n in flights.channels and n != "altitude")
    )
    theta = np.array([truth.get(p.name, p.start) for p in dynamics.free])
    flown, at = jax.tree.map(jnp.asarray, cut.nameless), jnp.asarray(theta)
    kept = [c for c, name in enumerate(cut.outputs) if name not in FLOW]  # vane and pitot tube have units of their own
    one, other = (np.asarray(x(flown, at))[:, :, kept] for x in (bare, ours))
    apart = np.abs(one + other).max() / np.abs(one).max()
    print(f"{flights.n} samples, {len(theta)} parameters, {len(dynamics.states)} states, {len(cut.outputs)} outputs")
    print(f"sensitivities agree to {apart:.1e}")
    for _ in range(3):
        scan, own = best(lambda: bare(flown, at)), best(lambda: ours(flown, at))
        print(f"bare scan {1e3 * scan:.0f} ms, with sensitivities as fitted {1e3 * own:.0f} ms: {own / scan:.2f} x")
    fit_output_error(cut, start=1.1 * theta)
    begin = time.perf_counter()
    found = fit_output_error(cut, start=1.1 * theta)
    print(f"fit, warm: {time.perf_counter() - begin:.2f} s, {found.iterations} iterations, {found.status.value}")


if __name__ == "__main__":
    main()
