"""The posterior of HFB-320 with process noise: this package's filter against dynamax's, by one sampler.

    python benchmarks/dynamax_race.py /path/to/hfb320_1_10.asc [--warmup 100] [--blocks 1] [--chains 1]

needs dynamax (`pip install dynamax "fastprogress<1.1" tfp-nightly`, which no extra installs). Both sides have the
states airspeed, alpha, theta and q, seven outputs, the measured initial state with its deviation, 11 parameters, process
noise of four states and seven measurement noises, all free, with the same priors. Motion and outputs are the package's
functions on both sides, so what is compared is `innovations_density` and `extended_kalman_filter`, each with its
gradient. NUTS is NumPyro's on coordinates whitened at the same mode, with the settings of `fly --posterior`.
dynamax has no process noise that depends on the state: the share of the noise that the transition gathers within a
sample is computed along the path of the fit there, so values are the same at the fit, and gradients differ by what a
move of that path changes in this share. Its outputs are scaled to unit noise: it adds 1e-9 to the diagonal of their
covariance when it solves for the gain.

Times are processor time of this process.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import bayes_aero as ba
from bayes_aero.diagnosis.trajectories.trajectory_fit import fit_trajectories
from bayes_aero.dynamics.filtering.kalman import discrete_noise, outputs_at
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import prepare
from bayes_aero.dynamics.system import advance
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.inference.likelihood.disturbed import FIRST_F, FIRST_R
from bayes_aero.inference.likelihood.prediction_error import PredictionErrorResult, fit_prediction_error
from bayes_aero.inference.posterior.innovations import SHORT, InnovationsDensity, innovations_posterior
from bayes_aero.inference.posterior.laplace import find_mode
from bayes_aero.inference.posterior.nuts import NutsLength, sample_nuts
from bayes_aero.jobs.options import FlyOptions
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.log_density import LogDensity
from bayes_aero.model.model import Model

CALLS = 10  # of which the median is timed


class DynamaxDensity(InnovationsDensity):
    """The same density, its likelihood by dynamax; `path` (n, s), after corrections, and `sd` (c,) are the fit's."""

    path: Any
    sd: Any

    def log_likelihood(self, x):
        """By `extended_kalman_filter`, which predicts sample t with row t: the inputs of samples t - 1 and t."""
        from dynamax.nonlinear_gaussian_ssm import ParamsNLGSSM, extended_kalman_filter

        flown, k, c = self.flown, len(self.flown.dynamics.free), len(self.flown.outputs)
        prepared = prepare(flown, x[:k])
        system, names, dt = prepared.system, list(prepared.drives), flown.dt[0]
        now = jnp.stack([prepared.drives[name][0] for name in names], axis=1)
        row = lambda u: dict(zip(names, u, strict=True))  # noqa: E731
        F2 = x[k:-c] ** 2
        ahead = jnp.concatenate([now[1:], now[-1:]])

        def moved(x, now, then):
            return advance(system, x, row(now), row(then), dt, 1)

        Q = jax.vmap(lambda *y: discrete_noise(jax.jacfwd(moved)(*y), F2, dt))(self.path, now, ahead)
        first = row(now[0])
        begin = system.complete_start(prepared.begin[0], first)
        params = ParamsNLGSSM(
            initial_mean=begin,
            initial_covariance=system.start_covariance(begin, first, jnp.asarray(self.deviation)),
            dynamics_function=lambda x, u: moved(x, u[: len(names)], u[len(names) :]),
            dynamics_covariance=jnp.concatenate([Q[:1], Q[:-1]]),
            emission_function=lambda x, u: outputs_at(system, x, row(u[len(names) :]), flown.outputs) / self.sd,
            emission_covariance=jnp.diag((x[-c:] / self.sd) ** 2),
        )
        inputs = jnp.concatenate([jnp.concatenate([now[:1], now[:-1]]), now], axis=1)
        found = extended_kalman_filter(params, prepared.true[0] / self.sd, inputs, output_fields=[])
        total = found.marginal_loglik - len(now) * jnp.sum(jnp.log(self.sd))
        return jnp.where(jnp.isfinite(total), total, -jnp.inf)


@dataclass(frozen=True)
class Race:
    """Both densities, our fit, and its start: parameters (k,), process noise and variances of the measurement noise."""

    densities: dict[str, Any]
    fit: PredictionErrorResult
    start: tuple[np.ndarray, np.ndarray, np.ndarray]
    seconds: float  # of the fit


def race_of(path: str) -> Race:
    """Fit without gusts, as dynamax has no noise that depends on the state."""
    card = ba.read_card("hfb320")
    setting = FlyOptions().setting(card)
    flights, _ = despiked(join(ba.read([path], card), card, FLIGHT))
    dynamics = aircraft_dynamics(Model.from_card(card), flights, setting.outputs or ())
    units = {name: channel.unit for name, channel in STANDARD_CHANNELS.items()}
    output_error = fit_trajectories(flights, dynamics, units, setting=setting).fit
    sd = np.sqrt(output_error.R)
    F = np.array([FIRST_F * sd[output_error.flown.outputs.index(name)] for name in dynamics.states])
    start = np.asarray(output_error.estimate), F, FIRST_R * output_error.R
    began = time.process_time()
    fit = fit_prediction_error(output_error.flown, *start[1:], start=start[0])
    seconds = time.process_time() - began
    ours = innovations_posterior(output_error.flown, output_error.R)
    shared = {name: getattr(ours, name) for name in ("flown", "deviation", "levels")}
    theirs = DynamaxDensity(**shared, path=np.asarray(fit.found.state[0]), sd=np.sqrt(fit.R))
    return Race({"bayes_aero": ours, "dynamax": theirs}, fit, start, seconds)


def timed(density: LogDensity, u: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
    """Seconds to compile and milliseconds of value and gradient; the gradient."""
    both = eqx.filter_jit(lambda d, u: jax.value_and_grad(d)(u))
    one = eqx.filter_jit(lambda d, u: d(u))
    told: dict[str, float] = {}
    for name, f in (("density", one), ("with gradient", both)):
        began = time.process_time()
        found = jax.block_until_ready(f(density, u))
        told[f"{name}, first, s"] = time.process_time() - began
        each = []
        for _ in range(CALLS):
            began = time.process_time()
            jax.block_until_ready(f(density, u))
            each.append(time.process_time() - began)
        told[f"{name}, ms"] = 1e3 * float(np.median(each))
    return told, np.asarray(found[1])


def main() -> None:
    """Agreement, time of a call, optimum, and effective samples a second."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("record")
    parser.add_argument("--chains", type=int, default=1)
    parser.add_argument("--warmup", type=int, default=100)
    parser.add_argument("--blocks", type=int, default=1, help="of 300 draws a chain, at most; 0: no sampling")
    asked = parser.parse_args()
    try:
        import dynamax  # noqa: F401
    except ModuleNotFoundError as missing:
        sys.exit(f"{missing.name} is not installed; this comparison needs it: see the first lines of this file")
    race = race_of(asked.record)
    print(f"fit by Fisher scoring: {race.fit.status.value}, {race.fit.log_likelihood:.6f}, {race.seconds:.1f} s")
    ours = race.densities["bayes_aero"]
    u = np.asarray(ours.unconstrain(jnp.asarray(ours.start(race.fit))))
    values, slopes = {}, {}
    for name, density in race.densities.items():
        values[name] = float(density.log_likelihood(density.constrain(jnp.asarray(u))))
        told, slopes[name] = timed(density, jnp.asarray(u))
        print(
            f"{name}: log likelihood {values[name]:.9f};",
            ", ".join(f"{k} {v:.3g}" for k, v in told.items()),
            flush=True,
        )
    apart = np.max(np.abs(slopes["dynamax"] - slopes["bayes_aero"]) / (1.0 + np.abs(slopes["bayes_aero"])))
    print(f"at the fit: values {abs(values['dynamax'] - values['bayes_aero']):.1e} nats apart, gradients {apart:.1e}")
    if not asked.blocks:
        return
    mode = None
    for name, density in race.densities.items():
        began = time.process_time()
        found = find_mode(density, ours.start(race.fit))
        seconds = time.process_time() - began
        mode = mode or found
        print(f"{name}: mode {found.log_density:.4f} ({found.status.name.lower()}) in {seconds:.1f} s", flush=True)
    length = NutsLength(asked.chains, SHORT._replace(steps=asked.warmup), asked.blocks)
    for name, density in race.densities.items():
        began = time.process_time()
        found = sample_nuts(density, mode, seed=1, predictive=False, length=length)
        seconds = time.process_time() - began
        ess = np.sort([m.ess_bulk for m in found.marginals.values()])
        print(
            f"{name}, NUTS: bulk ESS least {ess[0]:.0f}, median {np.median(ess):.0f} in {seconds:.0f} s: "
            f"{ess[0] / seconds:.3g} and {np.median(ess) / seconds:.3g} a second"
            + (f"; R-hat {max(m.rhat for m in found.marginals.values()):.3f}" if asked.chains > 1 else "")
        )
        steps = found.tree["sample_stats"].dataset
        mean = {key: float(steps[key].mean()) for key in ("n_steps", "acceptance_rate", "diverging")}
        print("   ", ", ".join(f"{key} {value:.3g}" for key, value in mean.items()), "a draw", flush=True)


if __name__ == "__main__":
    main()
