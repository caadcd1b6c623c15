"""HFB-320 with given process and measurement noise: aeroid's extended Kalman filter against ours.

    OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 python benchmarks/aeroid_filter.py /path/to/hfb320_1_10.asc

needs aeroid (extra `bench`). Our fit without gusts estimates 11 parameters, process noise of four states and seven
measurement noises. aeroid estimates no noise: it is given ours, with the measured initial state and its deviations.
Its `filter_error` minimises the squares of the whitened innovations, without the determinant of their covariance,
which depends on the parameters too. Its process noise of a sample is Q dt, ours is what the transition gathers.
Processor time; ours warm, after one fit that compiles.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import aeroid
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from aeroid_jet import jet_model
from dynamax_race import Race, race_of

from bayes_aero.inference.likelihood.prediction_error import fit_prediction_error
from bayes_aero.physics.atmosphere import GRAVITY

CALLS = 10


def spent(call: Callable[[], Any]) -> tuple[float, Any]:
    """Processor seconds and result."""
    began = time.process_time()
    result = call()
    return time.process_time() - began, result


def theirs(race: Race) -> tuple[aeroid.Model, aeroid.FlightData, dict]:
    """aeroid's model at our estimate, its data, and what its filter is told."""
    fit, density = race.fit, race.densities["bayes_aero"]
    flown = density.flown
    states, outputs = flown.dynamics.states, flown.outputs
    values = dict(zip(fit.names, map(float, fit.estimate), strict=True))
    model = jet_model(np, flown.flights.aircraft, GRAVITY, states, values, ("q_dot",))
    channels = {name: np.asarray(x) for name, x in flown.flights.channels.items()}
    kept = {name: channels[name] for name in ("elevator", "thrust", *outputs)}
    begin = {f"x_{name}": float(channels[name][0]) for name in states}
    told = {
        "process_noise": {f"x_{name}": F**2 for name, F in zip(states, map(float, fit.F), strict=True)},
        "measurement_noise": dict(zip(outputs, map(float, fit.R), strict=True)),
        "outputs": outputs,
        "x0": begin,
    }
    deviation = {f"x_{name}": sd**2 for name, sd in zip(states, density.deviation, strict=True)}
    data = aeroid.FlightData(np.asarray(flown.flights.time), kept)
    return model, data, told | {"P0": deviation}


def main() -> None:
    """Log likelihood, time of a call, time of a fit, and how far the estimates are apart."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record")
    race = race_of(parser.parse_args().record)
    fit, density = race.fit, race.densities["bayes_aero"]
    x = jnp.asarray(density.start(fit))
    likelihood = eqx.filter_jit(lambda density, x: density.log_likelihood(x))
    likelihood(density, x).block_until_ready()
    model, data, told = theirs(race)
    calls = {
        "bayes_aero": lambda: float(likelihood(density, x)),
        "aeroid": lambda: aeroid.filter_states(model, data, smooth=False, **told).log_likelihood,
    }
    still = told | {"process_noise": dict.fromkeys(told["process_noise"], 1e-24)}
    nearly = aeroid.filter_states(model, data, smooth=False, **still).log_likelihood
    noiseless = x.at[len(fit.names) : len(fit.names) + len(fit.F)].set(1e-12)
    print(f"without process noise: {float(likelihood(density, noiseless)):.6f}, aeroid {nearly:.6f}", flush=True)
    for name, call in calls.items():
        seconds, values = spent(lambda call=call: [call() for _ in range(CALLS)])
        print(f"{name}: log likelihood {values[0]:.6f}, {1e3 * seconds / CALLS:.3g} ms a call", flush=True)
    theta, *noises = race.start
    seconds, again = spent(lambda: fit_prediction_error(density.flown, *noises, start=theta))
    print(f"bayes_aero: fit with all noises free, warm, {seconds:.3g} s; {again.status.value}", flush=True)
    start = dict(zip(fit.names, map(float, theta), strict=True))
    P0 = told.pop("P0")
    seconds, found = spent(
        lambda: aeroid.identify(
            model, data, fit.names, method="filter_error", initial_guess=start, filter_options={"P0": P0}, **told
        )
    )
    apart = [(found.parameters[n] - x) / sd for n, x, sd in zip(fit.names, fit.estimate, fit.sd, strict=True)]
    ratio = [found.stderr[n] / sd for n, sd in zip(fit.names, fit.sd, strict=True)]
    print(f"aeroid: fit with noises given, {seconds:.3g} s, {found.n_evaluations} runs of its filter")
    there = aeroid.filter_states(model, data, found, smooth=False, P0=P0, **told).log_likelihood
    moved = x.at[: len(fit.names)].set(jnp.asarray([found.parameters[name] for name in fit.names]))
    print(f"    log likelihood of its estimate: {there:.2f} by aeroid, {float(likelihood(density, moved)):.2f} by ours")
    for name, a, r in zip(fit.names, apart, ratio, strict=True):
        print(
            f"    {name}: {found.parameters[name]:.5g}, {a:+.2f} of our standard errors apart, its own {r:.2f} of ours"
        )


if __name__ == "__main__":
    main()
