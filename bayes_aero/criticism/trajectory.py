"""The simulation before and after the extension: fitted to trajectories, flown on what it was not fitted to.

Every manoeuvre is left out in turn. A single one is cut in two halves, each flown by the fit to the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Event

import equinox as eqx
import numpy as np
from jaxtyping import Float

from bayes_aero.criticism.finding import Diagnosis
from bayes_aero.criticism.flown_colour import colour_cost
from bayes_aero.criticism.flown_paths import Error as Error
from bayes_aero.criticism.flown_paths import Path, label, paths_of, posterior_covariance
from bayes_aero.effect import Stage
from bayes_aero.inference.cores import blas_threads, cores
from bayes_aero.inference.output_error import fit_cascade, fit_output_error
from bayes_aero.inference.output_error_result import OutputErrorResult, OutputErrorStatus
from bayes_aero.model.dynamics import aircraft_dynamics
from bayes_aero.model.flights import Flights
from bayes_aero.model.model import Model
from bayes_aero.model.segments import Flown, segments

WINDOW = 12.0  # s, of the first fits
BEGIN_COST = 30.0  # taken for the colour's cost until it is measured
LEFT = ("altitude",)  # reported, not fitted: it adds wind and pressure errors to what attitude and alpha tell already
UNKNOWN = 10.0  # times the joint fit's deviation from which a manoeuvre says nothing of a cause

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Estimates:
    """One model as fitted to all trajectories: its parameters (SI) by name, and how the fit ended."""

    values: Mapping[str, float]
    units: Mapping[str, str]
    status: OutputErrorStatus
    at_bound: tuple[str, ...]
    held: tuple[str, ...]  # by their priors: the trajectories say next to nothing of them

    @classmethod
    def of(cls, fit: OutputErrorResult) -> Estimates:
        """What is told of a fit."""
        values = dict(zip(fit.names, map(float, fit.estimate), strict=True))
        return cls(values, {p.name: p.unit for p in fit.parameters}, fit.status, fit.at_bound, fit.held)


@dataclass(frozen=True)
class Trajectories:
    """What simulations say of the card's model and of the extended one."""

    paths: tuple[Path, ...]
    card: Estimates
    extended: Estimates
    deviation: Mapping[str, float]  # of the extended model's parameters, the residuals' colour counted
    colour_cost: float  # how many times the colour multiplies variances
    held: Mapping[str, tuple[str, ...]]  # causes held at their joint estimate when a manoeuvre is fitted alone
    fitted: tuple[str, ...]  # outputs
    outputs: tuple[str, ...]  # all that were recorded

    def path(self, manoeuvre: str, model: str, split: str) -> Path | None:
        """One of the paths."""
        return next((p for p in self.paths if (p.manoeuvre, p.model, p.split) == (manoeuvre, model, split)), None)


@blas_threads(0)
def fly_both(
    flights: Flights,
    diagnosis: Diagnosis,
    tolerances: Mapping[str, float],
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Trajectories:
    """Fit the card's model and the extended one to the trajectories, jointly and with each manoeuvre left out.

    The extended one has the causes that unseen data confirm.
    """
    field = diagnosis.aerodynamics.state.field
    causes = [c.name for c in diagnosis.causes if c.confirmed]
    added = [e for e in field.model.effects if e.name in causes]
    base = [e for e in field.model.effects if e.name in field.base or not e.parameters]
    found = dict(zip(field.model.names, diagnosis.theta, strict=True))
    card_state = diagnosis.aerodynamics.base
    before = dict(zip(card_state.field.model.names, card_state.theta, strict=True))
    model = _extended(field.model, [*base, *added])
    ours = _side(model, flights, {name: found[name] for name in model.names})
    neutral = {p.name: field.neutral[p.name] for e in added for p in e.parameters if p.name in model.names}
    theirs = replace(ours, start=np.array([neutral.get(name, before[name]) for name in model.names]))
    if any(e.stage is Stage.LAG for e in added):  # a state that the card's model does not have
        bare = _extended(field.model, base)
        theirs, neutral = _side(bare, flights, {name: before[name] for name in bare.names}), {}

    own = {p.name for e in added for p in e.parameters}

    def tell(text: str, share: float) -> None:
        if progress:
            progress(f"trajectories: {text}", share)

    tell("extended model", 0.0)
    joint = fit_cascade([ours.window, ours.whole], [ours.start], prior_weight=BEGIN_COST)
    cost, _ = colour_cost(joint)
    joint = fit_output_error(ours.whole, start=joint.estimate, departure=joint.departure, prior_weight=cost)
    tell("card's model", 0.3)
    fitted = dict(zip(joint.names, joint.estimate, strict=True))
    shared = np.array([fitted[name] for name in theirs.whole.dynamics.names])
    starts = [theirs.start, shared]  # a model with something missing may have several optima
    card = fit_cascade([theirs.window, theirs.whole], starts, held=neutral, prior_weight=cost)
    paths, held = [], {}
    for name, fit in (("card", card), ("extended", joint)):
        paths += paths_of(fit, fit.flown, name, "fitted", fit.departure, tolerances)
    tell("left out", 0.5)
    jobs = []
    for k in range(len(ours.whole.index)):
        silent = {n: fitted[n] for n in _silent(joint, _masked(ours.whole, k, keep=False)) if n in own}
        held[label(ours.whole, k)] = tuple(silent)
        jobs += [(k, "card", card, neutral), (k, "extended", joint, silent)]
    for number, found in enumerate(_unseen(jobs, tolerances, cost, seed), start=1):
        paths += found
        tell("left out", 0.5 + 0.4 * number / len(jobs))
    sd = np.sqrt(np.diag(posterior_covariance(joint, cost)))
    return Trajectories(
        paths=tuple(paths),
        card=Estimates.of(card),
        extended=Estimates.of(joint),
        deviation=dict(zip(joint.names, map(float, sd), strict=True)),
        colour_cost=cost,
        held=held,
        fitted=ours.whole.outputs,
        outputs=tuple(n for n in ours.whole.dynamics.outputs if n in flights.channels),
    )


def _unseen(
    jobs: Sequence[tuple[int, str, OutputErrorResult, Mapping[str, float]]],
    tolerances: Mapping[str, float],
    cost: float,
    seed: int,
) -> Iterator[list[Path]]:
    """Each job (segment, name of the model, its fit to all, what is held): the segment flown by a fit to the others.

    Two fits keep as many cores busy as one with twice the segments, so several are made at once.
    """
    stopped, others = Event(), max(1, len(jobs[0][2].flown.index) - 1)

    def one(job) -> list[Path]:
        k, name, fit, held = job
        rest, seen = (_masked(fit.flown, k, keep=keep) for keep in (False, True))
        options = {"held": held, "prior_weight": cost, "stopped": stopped.is_set}
        again = fit_output_error(rest, start=fit.estimate, **options)
        if stopped.is_set():
            return []
        return paths_of(again, seen, name, "unseen", np.zeros_like(fit.departure), tolerances, cost, seed)

    with ThreadPoolExecutor(max(1, cores() // others)) as pool:
        try:
            yield from pool.map(one, jobs)
        except BaseException:  # Ctrl-C does not wait for whole fits
            stopped.set()
            raise


@dataclass(frozen=True)
class _Side:
    """One model, cut for its fits: windows first, then whole manoeuvres (or the halves of a single one)."""

    window: Flown
    whole: Flown
    start: Float[np.ndarray, " k"]


def _side(model: Model, flights: Flights, values: Mapping[str, float]) -> _Side:
    dynamics = aircraft_dynamics(model, flights)
    start = np.array([values[name] for name in model.names])
    outputs = tuple(n for n in dynamics.outputs if n in flights.channels and n not in LEFT)
    half = _half(flights) if len(flights.lengths) == 1 else None
    finer = dynamics.substeps(start, flights)
    window, whole = (segments(flights, dynamics, outputs=outputs, window=w, substeps=finer) for w in (WINDOW, half))
    return _Side(window, whole, start)


def _extended(whole: Model, effects: Sequence) -> Model:
    """The chosen effects with the parameters and fixed values that they have in the model of all candidates."""
    own = {p.name for e in effects for p in e.parameters}
    parameters = {p.name: p for p in whole.parameters}
    model = Model.of(effects, {k: v for k, v in whole.fixed if k in own})
    return replace(model, parameters=tuple(parameters[p.name] for p in model.parameters))


def _half(flights: Flights) -> float:
    return 0.5 * flights.lengths[0] * float(flights.channels["dt"][0])


def _masked(flown: Flown, row: int, *, keep: bool) -> Flown:
    """Only one of the segments counts, or all others; the shapes stay, so nothing compiles anew."""
    counts = (np.arange(len(flown.index)) == row) == keep
    return eqx.tree_at(lambda f: f.inside, flown, flown.inside & counts[:, None])


def _silent(joint: OutputErrorResult, others: Flown) -> list[str]:
    """Parameters of which the segments that are left say less than a hundredth of what all say."""
    part = fit_output_error(others, start=joint.estimate, departure=joint.departure, most=0)
    alone = part.crb
    with np.errstate(invalid="ignore"):
        return [n for n, a, b in zip(joint.names, alone, joint.crb, strict=True) if not a < UNKNOWN * b]
