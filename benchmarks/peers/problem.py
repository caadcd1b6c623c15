"""The common data: residuals and density of the stall model in NumPy, shown to be ours, and samples for the GPs."""

from __future__ import annotations

import argparse
import json
import pickle
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from contender import OURS, PROBLEM, Problem
from reference import Reference, WhitePosterior, agree, load

from bayes_aero.inference.gp.kernel import Scaling
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.results import MleStatus
from bayes_aero.inference.sampling import density_start, find_mode
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Density, Noise
from bayes_aero.model.observations import Observations

INPUTS = ("alpha", "elevator", "q", "airspeed")


def prepare(options: argparse.Namespace) -> None:
    """Fill the folder from the records of the command line."""
    _, model, observations = load(options.records)
    if options.quick:
        observations = observations.thinned()
    asked = {"of": [str(path) for path in options.records], "sizes": options.sizes, "quick": options.quick}
    lay_down(model, observations, options.folder, asked)


def lay_down(model: Model, observations: Observations, folder: Path, asked: dict) -> None:
    """What every contender reads, and last, in facts.json, what the table says of it."""
    best = fit_mle(model, observations, extra_starts=0)
    if best.status is not MleStatus.CONVERGED:
        raise SystemExit(f"These records cannot serve for a comparison; our own fit of them: {best.status.value}")
    density = Density(observations, model, Noise(Colour.WHITE))
    mode = find_mode(density, density_start(density, best))
    reference, posterior = Reference(observations, model.names), WhitePosterior(density)
    start = np.array([p.start for p in model.free])
    apart = [
        agree(
            np.asarray(model.predicted(jnp.asarray(theta), observations.signals, observations.aircraft)).T,
            reference(theta),
        )
        for theta in (start, best.estimate)
    ]
    near = mode.unwhiten(np.random.default_rng(1).standard_normal((10, density.size)))
    values = np.array([float(density(jnp.asarray(u))) for u in near])
    apart.append(agree(values, np.array([posterior(u) for u in near])))
    problem = Problem(
        folder=folder,
        reference=reference,
        posterior=posterior,
        start=start,
        R=np.asarray(best.R),
        u=mode.u,
        factor=mode.factor,
        names=density.names,
        processes={n: lift_samples(observations, n) for n in asked["sizes"]},
    )
    (folder / OURS).write_bytes(pickle.dumps(observations))
    (folder / PROBLEM).write_bytes(pickle.dumps(problem))
    facts = {"samples": observations.n, "manoeuvres": len(observations.names), "apart": max(apart)}
    (folder / "facts.json").write_text(json.dumps(asked | facts | {"device": jax.devices()[0].platform}))


def lift_samples(observations: Observations, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Scaled inputs (n, 4) and CL (n,) of `n` samples chosen at random, the same ones in every run."""
    if n > observations.n:
        raise SystemExit(f"The records have {observations.n} samples, fewer than the {n} of --sizes.")
    rows = np.sort(np.random.default_rng(0).choice(observations.n, n, replace=False))
    X = np.stack([np.asarray(observations.signals[name])[rows] for name in INPUTS], axis=1)
    y = np.asarray(observations.measured)[rows, 0]
    scaling = Scaling.of(X, y, INPUTS)
    return scaling.inputs(X), y / scaling.rms
