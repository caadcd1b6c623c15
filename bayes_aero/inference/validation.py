"""Gaussian processes beside maximum likelihood, trained and tested on the same points, for every kind of split."""

from __future__ import annotations

import time
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from bayes_aero.errors import InputError
from bayes_aero.inference.gp import GPFit, Priors, fit_gp
from bayes_aero.inference.identification import GPReport, Validation
from bayes_aero.inference.mle import MleResult, fit_mle
from bayes_aero.inference.scores import score
from bayes_aero.inference.splits import Split, SplitKind, make_splits
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Observations
from bayes_aero.physics.coefficients import NAMES

KINDS: tuple[SplitKind, ...] = ("random", "block", "manoeuvre")
LEVEL = 0.95


def gp_inputs(observations: Observations, names: tuple[str, ...]) -> Float[np.ndarray, "n d"]:
    """The regression inputs as columns, SI and radians."""
    for name in names:
        if name not in observations.signals:
            raise InputError(f"the Gaussian process needs the signal {name}; map it on the card or change [gp] inputs")
    return np.stack([np.asarray(observations.signals[name]) for name in names], axis=1)


def validate(
    model: Model,
    observations: Observations,
    mle: MleResult,
    inputs: tuple[str, ...],
    *,
    chosen: SplitKind,
    seed: int = 0,
    kinds: tuple[SplitKind, ...] = KINDS,
    progress: Callable[[str, float], None] | None = None,
) -> GPReport:
    """Train on each split's training points and score on its test points, both models on the same ones.

    Hyperparameters are sampled for the first fold of the `chosen` split and taken at their mode for the others.
    A split that the records do not allow (`manoeuvre` with one record) is left out.
    """
    began = time.perf_counter()
    if len(observations.names) < 2:
        kinds = tuple(kind for kind in kinds if kind != "manoeuvre")
        chosen = "block" if chosen == "manoeuvre" else chosen
    splits = {kind: make_splits(kind, observations.manoeuvre, observations.dt, seed) for kind in kinds}
    total = len(NAMES) * sum(len(folds) for folds in splits.values())
    X = gp_inputs(observations, inputs)
    found: dict[str, list[dict[str, Validation]]] = {}
    fits: dict[str, GPFit] = {}
    done = 0
    for kind, folds in splits.items():
        found[kind] = []
        for number, fold in enumerate(folds):
            predicted = _mle_prediction(model, observations, mle, fold)
            row = {}
            for i, name in enumerate(NAMES):
                if progress:
                    progress(f"GP of {name}, {kind} split", done / total)
                sampled = kind == chosen and number == 0
                row[name], fit = _one(observations, X, inputs, fold, i, predicted, sampled, seed)
                if sampled:
                    fits[name] = fit
                done += 1
            found[kind].append(row)
    return GPReport(found, fits, chosen, time.perf_counter() - began)


def _mle_prediction(model: Model, observations: Observations, mle: MleResult, fold: Split) -> Float[np.ndarray, "m 3"]:
    """Maximum likelihood on the training points, evaluated at the test points."""
    trained = fit_mle(model, observations.subset(fold.train_idx), start=mle.estimate, extra_starts=0)
    y = model.coefficients(jnp.asarray(trained.estimate), observations.signals, observations.aircraft)
    return np.asarray(y)[fold.test_idx]


def _one(
    observations: Observations,
    X: Float[np.ndarray, "n d"],
    inputs: tuple[str, ...],
    fold: Split,
    column: int,
    mle: Float[np.ndarray, "m 3"],
    sampled: bool,
    seed: int,
) -> tuple[Validation, GPFit]:
    z = np.asarray(observations.measured)[:, column]
    measured = z[fold.test_idx]
    fit = fit_gp(
        X[fold.train_idx],
        z[fold.train_idx],
        input_names=inputs,
        output_name=NAMES[column],
        priors=Priors.quasi_steady(),
        sample=sampled,
        seed=seed,
        progress=lambda _: None,
    )
    prediction = fit.predict(X[fold.test_idx])
    level = prediction.levels.index(LEVEL)
    validation = Validation(
        test=fold.test_idx,
        measured=measured,
        gp=prediction.mean,
        gp_low=prediction.low[level],
        gp_high=prediction.high[level],
        mle=mle[:, column],
        gp_scores=score(measured, prediction.mean),
        mle_scores=score(measured, mle[:, column]),
        coverage=prediction.coverage(measured),
        k_hat=float(fit.k_hat) if np.isfinite(fit.k_hat) else None,
        status=fit.status.value if sampled else fit.map_status.value,
    )
    return validation, fit
