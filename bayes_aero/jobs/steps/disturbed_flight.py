"""The fit with process noise beside output error, and its posterior."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from bayes_aero.diagnosis.trajectories.process_noise import with_process_noise
from bayes_aero.diagnosis.trajectories.results import ProcessNoise, TrajectoryFit
from bayes_aero.errors import attempted
from bayes_aero.flight.card.card import Card
from bayes_aero.inference.posterior.innovations import ENGINES
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.jobs.io.fly_json import Flight
from bayes_aero.jobs.options import FlyOptions
from bayes_aero.progress import Progress
from bayes_aero.report.text.process_noise import posterior_sentences

Sampling = Callable[[str], dict[str, Posterior]]


def process_noise(
    flown: TrajectoryFit, options: FlyOptions, card: Card, out: Path | None, progress: Progress | None
) -> tuple[tuple[ProcessNoise | None, Sampling | None], tuple[str, ...]]:
    """The fit with process noise where it was asked for and output error has a result to start from; what samples its
    posterior where that was asked for and the fit has converged."""
    if not (options.filtered and flown.converged):
        return (None, None), ()
    if progress:
        progress("process noise", 0.9)
    own = bool(card.effect_files)
    fit = partial(with_process_noise, flown)
    found, failed = attempted("Process noise was not fitted", fit, None, out, own=own)
    if found is None:
        return (None, None), failed
    beside, sample = found
    wanted = options.posterior and beside.converged
    return (beside, partial(sample, options.seed, progress) if wanted else None), failed


def with_posterior(
    found: Flight, sample: Sampling, card: Card, out: Path | None, put: Callable[[Flight], None]
) -> Flight:
    """With the posterior, and what is said of its chains; what is known is `put` before each sampler, for minutes."""
    begun, posteriors, failures = found, {}, found.failures
    for engine in ENGINES:
        put(found)
        by = partial(sample, engine)
        new, failed = attempted("The posterior was not sampled", by, {}, out, own=bool(card.effect_files))
        posteriors, failures = posteriors | new, (*failures, *failed)
        said = (*begun.sentences, *posterior_sentences(posteriors))
        found = replace(begun, posteriors=posteriors, sentences=said, failures=failures)
    return found
