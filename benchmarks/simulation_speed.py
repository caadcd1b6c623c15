"""Simulation with sensitivities against a bare scan of the same equations, and fits, warm.

    OPENBLAS_NUM_THREADS=1 python benchmarks/simulation_speed.py [stall six fit filter] [--book ../shared/book]

`stall`: one stall manoeuvre of the card `attas`, in the plane of symmetry. `six`: three simulated manoeuvres of
`full_six` (3-2-1-1, doublets of aileron and rudder). The bare scan is Runge and Kutta's step written out, and its
forward derivative by JAX in all directions; both are first shown to compute the same. `fit`: output error of `six`, and
maximum likelihood of TC23. `filter`: HFB-320 in gusts: log density, gradient, 16 at once, and the fit.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bayes_aero.dynamics.aircraft import FLOW
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, prepare, segments, simulate
from bayes_aero.dynamics.system import later
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.reading import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.output_error import fit_output_error
from bayes_aero.inference.prediction_error import fit_disturbed, innovations_posterior
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join, observe
from bayes_aero.model.records import Forming
from bayes_aero.physics.aircraft import FLIGHT
from bayes_aero.simulate.demo import TRUTH, Request, simulate_stall
from bayes_aero.simulate.injection import synthetic


def compare(runs: Mapping[str, Callable[[], Any]], repeats: int = 5) -> None:
    """A line each with its least seconds and their ratio to the first. They run in turn, each once untimed: the first
    time it may compile, and later the shortest would pay for the caches and the memory that the longest left."""
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(repeats):
        for name, run in runs.items():
            jax.block_until_ready(run())
            began = time.perf_counter()
            jax.block_until_ready(run())
            times[name].append(time.perf_counter() - began)
    first = min(next(iter(times.values())))
    for name, taken in times.items():
        print(f"  {name:40s} {1e3 * min(taken):9.1f} ms  {min(taken) / first:7.2f} x", flush=True)


def step(system: Any, x: Any, now: Any, then: Any, dt: Any) -> Any:
    middle = {name: 0.5 * (now[name] + then[name]) for name in now}
    k1 = system.motion(x, now)[0]
    k2 = system.motion(x + 0.5 * dt * k1, middle)[0]
    k3 = system.motion(x + 0.5 * dt * k2, middle)[0]
    return x + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + system.motion(x + dt * k3, then)[0])


@eqx.filter_jit
def bare(cut: SegmentTrajectories, theta: Any) -> Any:
    prepared, dynamics, k = prepare(cut, theta), cut.dynamics, len(theta)

    def outputs(z):
        system = dynamics.system(dynamics.values(z[:k]), cut.flights.aircraft)

        def one(start, inputs, dt):
            def further(x, rows):
                found = system.motion(x, rows[0])[1]
                return step(system, x, rows[0], rows[1], dt), jnp.stack([found[name] for name in cut.outputs])

            return jax.lax.scan(further, system.state_at_start(start + z[k:]), (inputs, later(inputs)))[1]

        return jax.vmap(one)(prepared.begin, prepared.drives, jnp.asarray(cut.dt))

    return jax.jacfwd(outputs)(jnp.concatenate([theta, jnp.zeros(len(dynamics.start))]))


@eqx.filter_jit
def ours(cut: SegmentTrajectories, theta: Any) -> Any:
    k, s = len(theta), len(cut.dynamics.start)
    away = jnp.zeros((len(cut.index), s))
    residual = lambda theta, shared: simulate(cut, theta, away + shared).residual  # noqa: E731
    along = lambda t: jax.jvp(residual, (theta, jnp.zeros(s)), (t[:k], t[k:]))[1]  # noqa: E731
    return jax.vmap(along, out_axes=-1)(jnp.eye(k + s))


def flown(card: Card, records: Sequence[FlightRecord], truth: dict[str, float]) -> tuple[SegmentTrajectories, Any]:
    flights = join(list(records), card, ())
    dynamics = aircraft_dynamics(Model.from_card(card), flights)
    outputs = tuple(n for n in dynamics.outputs if n in flights.channels and n != "altitude")
    return segments(flights, dynamics, outputs=outputs), np.array([truth.get(p.name, p.start) for p in dynamics.free])


def stall() -> tuple[SegmentTrajectories, Any]:
    card = read_card("attas")
    return flown(card, [simulate_stall(0, card=card, sensor_noise=0.0, disturbance=0.0)], TRUTH)


def six() -> tuple[SegmentTrajectories, Any]:
    card, kinds = read_card("full_six"), ("elevator_3211", "aileron_doublet", "rudder_doublet")
    asked = [Request({}, kind, "white", seed=seed, duration=28.0) for seed, kind in enumerate(kinds)]
    made = [synthetic(one, card, CATALOGUE, one.manoeuvre) for one in asked]
    return flown(card, [one.record for one in made], {k: x for one in made for k, x in one.parameters.items()})


def sensitivities(name: str, cut: SegmentTrajectories, theta: Any) -> None:
    whole, at = jax.tree.map(jnp.asarray, cut.nameless), jnp.asarray(theta)
    kept = [c for c, output in enumerate(cut.outputs) if output not in FLOW]  # vane and pitot tube have their own units
    one, other = (np.asarray(x(whole, at))[cut.inside][:, kept] for x in (bare, ours))
    apart = np.abs(one + other).max() / np.abs(one).max()
    print(f"{name}: {cut.flights.n} samples, {len(theta)} parameters, Jacobians {apart:.0e} apart")
    compare({"bare scan": lambda: bare(whole, at), "bayes_aero": lambda: ours(whole, at)}, 7)


def fits(book: Path | None) -> None:
    cut, theta = six()
    runs: dict[str, Any] = {"output error, simulated": lambda: fit_output_error(cut, start=1.1 * theta)}
    if book is not None:
        card = read_card("full_six")
        records = [read_record(book / f"fAttas{name}.mat", card.channels) for name in ("Elv1", "Ail1", "Rud1")]
        model = Model.from_card(card)
        made = observe(records, card, model, Forming.PUBLISHED)
        runs["maximum likelihood, TC23"] = lambda: fit_mle(model, made, extra_starts=0)
    compare(runs)


def filters(book: Path) -> None:
    card = read_card("hfb320")
    flights = join([read_record(book / "hfb320_1_10.asc", card.channels)], card, FLIGHT)
    cut = segments(flights, aircraft_dynamics(Model.from_card(card), flights))
    start = fit_output_error(cut, start=fit_output_error(segments(flights, cut.dynamics, window=10.0)).estimate)
    gusty, found = fit_disturbed(cut, start.estimate, start.R)
    density = innovations_posterior(gusty, start.R)
    x, grad = jnp.asarray(density.start(found)), jax.grad(lambda x: density.log_likelihood(x))  # noqa: PLW0108
    value, slope, both = map(eqx.filter_jit, (density.log_likelihood, grad, jax.vmap(grad)))
    runs = {"log density": partial(value, x), "gradient": partial(slope, x), "16": partial(both, jnp.tile(x, (16, 1)))}
    compare(runs | {found.status.value: lambda: fit_disturbed(cut, start.estimate, start.R)[1].estimate}, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", default=["stall", "six", "fit"])
    parser.add_argument("--book", type=Path)
    given = parser.parse_args()
    for what in given.what:
        if what == "fit":
            fits(given.book)
        elif what == "filter":
            filters(given.book)
        else:
            sensitivities(what, *{"stall": stall, "six": six}[what]())


if __name__ == "__main__":
    main()
