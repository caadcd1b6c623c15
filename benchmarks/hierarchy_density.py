"""The hierarchy over the full density of the coefficients, beside the normal approximation of its manoeuvres."""

from __future__ import annotations

import time
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.flight.card.card import read_card
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.posterior.laplace import find_mode
from bayes_aero.inference.posterior.nuts import NutsLength, WarmUp, sample_nuts
from bayes_aero.inference.posterior.pooled.hierarchy import SCATTER, Hierarchy, pool
from bayes_aero.inference.posterior.pooled.normal_estimates import normal_estimates
from bayes_aero.model.density import Density
from bayes_aero.model.log_density import LogDensity
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import observe
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.simulate.demo import TRUTH, simulate_stall

FREE = ("CLa", "Cmde", "Cma", "alpha_star", "a1")
SIGMA = {"CL": 0.05, "CD": 0.02, "Cm": 0.02}
SCATTERS = 0.2  # of the priors' standard deviations, with which the manoeuvres are flown
THIN = 10  # one sample in so many: 4 s with the whole stall
LONG = NutsLength(chains=12, warmup=WarmUp(1000), max_blocks=4)


class FullHierarchy(LogDensity):
    """Aircraft, scatter and offsets in units of the priors, and the logarithms of the noise of every manoeuvre."""

    names_of: tuple[Parameter, ...] = eqx.field(static=True)
    flown: tuple[Density, ...]

    @classmethod
    def of(cls, model: Model, flown: tuple[Density, ...]) -> FullHierarchy:
        """The density of manoeuvres."""
        one, half = Prior("normal", 0.0, 1.0), Prior("halfnormal", 0.0, SCATTER)
        rows = [Parameter(f"aircraft {n}", "1", 0.0, 0.0, "", one) for n in model.names]
        rows += [Parameter(f"scatter {n}", "1", 0.0, SCATTER, "", half, (0.0, np.inf)) for n in model.names]
        rows += [Parameter(f"{n} {m}", "1", 0.0, 0.0, "", one) for m in range(len(flown)) for n in model.names]
        rows += [replace(p, name=f"{p.name} {m}") for m, d in enumerate(flown) for p in d.noise.parameters]
        return cls(tuple(rows), flown)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All of them."""
        return self.names_of

    @property
    def noise_label(self) -> str:
        """White noise."""
        return "white"

    def log_likelihood(self, x: Float[Array, " k"]) -> Float[Array, ""]:
        """Of all coefficients."""
        model, m = self.flown[0].model, len(self.flown)
        k = len(model.names)
        aircraft, scatter, offsets, noise = jnp.split(x, [k, 2 * k, (2 + m) * k])
        theta = aircraft + scatter * offsets.reshape(m, k)
        sigmas = noise.reshape(m, -1)
        total = jnp.zeros(())
        for number, density in enumerate(self.flown):
            own = [
                p.prior.location * jnp.exp(p.prior.scale * v)
                if p.prior.family == "lognormal"
                else p.prior.normal[0] + p.prior.normal[1] * v
                for p, v in zip(model.free, theta[number], strict=True)
            ]
            total = total + density.log_likelihood(jnp.concatenate([jnp.stack(own), sigmas[number]]))
        return total


def compare(manoeuvres: int) -> None:
    """Both posteriors of the same simulated stalls, parameter by parameter."""
    card = read_card("attas")
    whole = Model.from_card(card)
    held = {n: TRUTH[n] for n in whole.names if n not in FREE}
    model = replace(whole, fixed=tuple(sorted((dict(whole.fixed) | held).items())))
    rng, flown, alone = np.random.default_rng(5), [], {}
    clean = observe([simulate_stall(i, card=card, sensor_noise=0.0, disturbance=0.0) for i in range(2)], card, model)
    for m in range(manoeuvres):
        part = clean.subset(np.flatnonzero(clean.manoeuvre == m % 2)[::THIN])
        o = part.restarted(np.arange(part.n) == 0)
        offsets = SCATTERS * rng.standard_normal(len(model.names))
        theta = [
            TRUTH[p.name] * np.exp(p.prior.scale * v)
            if p.prior.family == "lognormal"
            else TRUTH[p.name] + v * p.prior.scale
            for p, v in zip(model.free, offsets, strict=True)
        ]
        exact = np.asarray(model.predicted(jnp.asarray(theta), o.signals, o.aircraft))
        noisy = exact + rng.standard_normal(exact.shape) * [SIGMA[c] for c in o.coefficients]
        o = replace(o.with_measured(jnp.asarray(noisy)), names=(f"flight{m}",))
        fit = fit_mle(model, o)
        alone[f"flight{m}"] = (o, replace(fit, corrected=fit.covariance))
        flown.append(Density.of(o, model, Noise(Colour.WHITE)))
    began = time.perf_counter()
    given = [normal_estimates(model, o, {name: fit}) for name, (o, fit) in alone.items()]
    y, information = (np.concatenate([getattr(g, key) for g in given]) for key in ("y", "information"))
    draws, sampled = pool(Hierarchy.of(model.names, y, information), seed=1)
    approximate = {"aircraft": draws.aircraft, "scatter": draws.scatter}
    print(f"normal approximation: {sampled.status.value}, {time.perf_counter() - began:.0f} s")
    density = FullHierarchy.of(model, tuple(flown))
    start = np.array([p.start for p in density.parameters])
    for m, (_, fit) in enumerate(alone.values()):
        start[-3 * (manoeuvres - m) :][:3] = np.sqrt(fit.R)
    full = sample_nuts(density, find_mode(density, start), seed=1, length=LONG, predictive=False)
    least = min(m.ess for m in full.marginals.values())
    print(f"full density, {density.size} parameters: {full.status.value}, ESS {least:.0f}, {full.seconds:.0f} s")
    for what, x in approximate.items():
        for i, name in enumerate(model.names):
            exact = full.marginals[f"{what} {name}"]
            shift, ratio = (x[..., i].mean() - exact.mean) / exact.sd, x[..., i].std() / exact.sd
            print(f"  {what:8s} {name:10s} {shift:+.3f} standard deviations apart, widths {ratio:.3f}")
