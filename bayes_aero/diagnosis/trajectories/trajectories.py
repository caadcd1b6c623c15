"""The simulation before and after the extension: fitted to trajectories, flown on what it was not fitted to.

Every manoeuvre is left out in turn. A single one is cut in two halves, each flown by the fit to the other. What the
extended model misses grows as the flow separates, and counts for less there (see `inference/noise_growth.py`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.trajectories.elimination import eliminate
from bayes_aero.diagnosis.trajectories.holdout_fits import CandidateFit, Noise, holdout_fits, left_out
from bayes_aero.diagnosis.trajectories.lag_test import confirmed, open_lag, with_lag
from bayes_aero.diagnosis.trajectories.results import Estimates, Path, Trajectories
from bayes_aero.diagnosis.trajectories.time_histories import label, paths_of, posterior_covariance
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_biases import biased_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.effect import Effect, Stage
from bayes_aero.inference.likelihood.output_error import fit_cascade, fit_output_error
from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult
from bayes_aero.inference.threads import blas_threads
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.model import Model
from bayes_aero.parameter import Prior
from bayes_aero.progress import Progress

WINDOW = 12.0  # s, of the first fits
FIRST_INFLATION = 30.0  # variance inflation that is assumed until it is measured
LEFT = ("altitude",)  # reported, not fitted: it adds wind and pressure errors to what attitude and alpha tell already


@blas_threads(0)
def compare_trajectories(
    flights: Flights,
    diagnosis: Diagnosis,
    tolerances: Mapping[str, float],
    *,
    biases: Mapping[str, Prior] | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Trajectories:
    """Fit the card's model and the extended one to the trajectories, jointly and with each manoeuvre left out.

    The extended model has the causes that hold-out coefficients confirm and hold-out flights need (see `flown_needed`).
    It has a separation lag if the coefficients do not decide on one and hold-out flights need it (see `flown_lag`).
    `biases`: outputs recorded with a constant error in each manoeuvre; they are fitted with the rest. Hold-out flights
    are compared with the record as it is.
    """
    whole = diagnosis.aerodynamics.state.full
    causes = [c.name for c in diagnosis.causes if c.confirmed]
    added = [e for e in whole.model.effects if e.name in causes]
    base = [e for e in whole.model.effects if e.name in whole.base or not e.parameters]
    found = dict(zip(whole.model.names, diagnosis.theta, strict=True))
    model = _extended(whole.model, [*base, *added])

    def tell(text: str, share: float) -> None:
        if progress:
            progress(f"trajectories: {text}", share)

    tell("extended model", 0.0)
    ours = _side(model, flights, found, biases)
    joint = fit_cascade([ours.window, ours.whole], [ours.start], prior_weight=FIRST_INFLATION)
    noise = Noise.of(joint)
    options = {"departure": joint.departure, "prior_weight": noise.variance_inflation}
    joint = fit_output_error(noise.on(ours.whole), start=joint.estimate, **options)
    extended = CandidateFit("extended", joint, frozenset(p.name for e in added for p in e.parameters))
    lagged, lag, effect = None, None, open_lag(whole, diagnosis.aerodynamics, model)
    if effect is not None:
        tell("separation lag", 0.2)
        lagged, lag = with_lag(
            _extended(whole.model, [*base, *added, effect]), effect, extended, noise, flights, whole.settings
        )
        lagged = lagged if lag.gains else None
    tell("card's model", 0.3)
    card = _card(diagnosis, _extended(whole.model, base), ours, added, extended, noise, flights, biases)
    contenders = [c for c in (extended, lagged, card) if c is not None]
    fits, silent = _left_out(contenders, noise, whole.settings.unidentified, tell)
    best = extended
    if lag is not None and lagged is not None:
        without, within = (holdout_fits(c, fits[c.name], {}) for c in (extended, lagged))
        flown, hold_out = joint.flown, whole.settings.hold_out
        lag = confirmed(lag, without, within, flown.outputs, flown.growth, noise.variance_inflation, hold_out)
        best = lagged if lag.kept else extended
    tell("causes that hold-out flights need", 0.8)
    flies = eliminate(best, fits[best.name], added, silent[best.name], noise, whole.settings)
    tell("errors", 0.9)
    paths = _paths({"card": card, "extended": flies.contender}, (fits["card"], flies.fits), noise, tolerances, seed)
    fit, gone = flies.contender.fit, flies.gone
    sd = np.sqrt(np.diag(posterior_covariance(fit, noise.variance_inflation)))
    return Trajectories(
        paths=tuple(paths),
        card=Estimates.of(card.fit),
        extended=Estimates.of(fit, gone),
        deviation={n: float(x) for n, x in zip(fit.names, sd, strict=True) if n not in gone},
        variance_inflation=noise.variance_inflation,
        held={label(fit.flown, k): tuple(n for n in names if n not in gone) for k, names in silent[best.name].items()},
        fitted=fit.flown.outputs,
        outputs=tuple(n for n in fit.flown.dynamics.outputs if n in flights.channels),
        noise_growth=noise.told(fit.flown.outputs),
        lag=lag,
        asked=flies.confirmation,
    )


def _left_out(
    contenders: Sequence[CandidateFit], noise: Noise, unidentified: float, tell: Progress
) -> tuple[dict[str, list], dict[str, dict]]:
    """By contender: its fits to all segments but one each, and by that segment what the others say nothing of."""
    tell("left out", 0.5)
    count = len(contenders[0].fit.flown.index)
    silent = {c.name: {k: c.silent(k, unidentified) for k in range(count)} for c in contenders}
    fits: dict[str, list[OutputErrorResult]] = {c.name: [] for c in contenders}
    for number, (name, fit) in enumerate(left_out(contenders, silent, noise), start=1):
        fits[name].append(fit)
        tell("left out", 0.5 + 0.3 * number / (count * len(contenders)))
    return fits, silent


def _paths(
    models: Mapping[str, CandidateFit],
    without: Sequence[Sequence[OutputErrorResult]],
    noise: Noise,
    tolerances: Mapping[str, float],
    seed: int,
) -> list[Path]:
    """What is shown of every model: fitted to all, then by each of its fits `without` a segment, on that segment."""
    paths = []
    for name, c in models.items():
        paths += paths_of(c.fit, c.fit.flown, name, "fitted", c.fit.departure, tolerances)
    for (name, c), fits in zip(models.items(), without, strict=True):
        paths += [replace(p, model=name) for p in holdout_fits(c, fits, tolerances, noise.variance_inflation, seed)]
    return paths


def _card(
    diagnosis: Diagnosis,
    bare: Model,
    ours: _Side,
    added: Sequence[Effect],
    extended: CandidateFit,
    noise: Noise,
    flights: Flights,
    biases: Mapping[str, Prior] | None,
) -> CandidateFit:
    """The card's model, the causes at neutral; from its own start and from what the extended one shares with it.

    Every sample counts the same: what it misses is not confined to the stall.
    """
    base, neutral = diagnosis.aerodynamics.base, diagnosis.aerodynamics.state.full.neutral
    before = dict(zip(base.full.model.names, base.theta, strict=True))
    held = {name: neutral[name] for name in extended.own if name in extended.fit.names}
    first = {p.name: p.start for p in ours.whole.dynamics.free} | before | held
    theirs = replace(ours, start=np.array([first[name] for name in ours.whole.dynamics.names]))
    if any(e.stage is Stage.LAG for e in added):  # a state that the card's model does not have
        theirs, held = _side(bare, flights, before, biases), {}
    fitted = dict(zip(extended.fit.names, extended.fit.estimate, strict=True))
    shared = np.array([fitted[name] for name in theirs.whole.dynamics.names])
    starts = [theirs.start, shared]  # a model with something missing may have several optima
    fit = fit_cascade([theirs.window, theirs.whole], starts, held=held, prior_weight=noise.variance_inflation)
    return CandidateFit("card", fit, held=held, weighed=False)


@dataclass(frozen=True)
class _Side:
    """One model, cut for its fits: windows first, then whole manoeuvres (or the halves of a single one)."""

    window: SegmentTrajectories
    whole: SegmentTrajectories
    start: Float[np.ndarray, " k"]


def _side(
    model: Model, flights: Flights, values: Mapping[str, float], biases: Mapping[str, Prior] | None = None
) -> _Side:
    dynamics = biased_dynamics(aircraft_dynamics(model, flights), flights, biases or {})
    start = np.array([values.get(p.name, p.start) for p in dynamics.free])
    outputs = tuple(n for n in dynamics.outputs if n in flights.channels and n not in LEFT)
    half = _half(flights) if len(flights.lengths) == 1 else None
    finer = dynamics.substeps(start, flights)
    window, whole = (segments(flights, dynamics, outputs=outputs, window=w, substeps=finer) for w in (WINDOW, half))
    return _Side(window, whole, start)


def _extended(whole: Model, effects: Sequence) -> Model:
    """The chosen effects with the parameters and fixed values that they have in the model of all candidates."""
    own = {p.name for e in effects for p in e.parameters}
    parameters = {p.name: p for p in whole.parameters}
    model = Model.of(effects, {k: v for k, v in whole.fixed if k in own}, whole.axes)
    return replace(model, parameters=tuple(parameters[p.name] for p in model.parameters))


def _half(flights: Flights) -> float:
    return 0.5 * flights.lengths[0] * float(flights.channels["dt"][0])
