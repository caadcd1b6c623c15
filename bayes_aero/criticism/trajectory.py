"""The simulation before and after the extension: fitted to trajectories, flown on what it was not fitted to.

Every manoeuvre is left out in turn. A single one is cut in two halves, each flown by the fit to the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_aero.criticism.finding import Diagnosis
from bayes_aero.criticism.residuals import TheilParts, theil_parts
from bayes_aero.effect import Stage
from bayes_aero.inference.coloured import corrected_covariance
from bayes_aero.inference.output_error import fit_cascade, fit_output_error, trajectories
from bayes_aero.inference.output_error_result import THINNED, OutputErrorResult, OutputErrorStatus
from bayes_aero.model.dynamics import aircraft_dynamics
from bayes_aero.model.flights import Flights
from bayes_aero.model.model import Model
from bayes_aero.model.segments import Flown, segments, simulate

WINDOW = 12.0  # s, of the first fits
BEGIN_COST = 30.0  # taken for the colour's cost until it is measured
LEFT = ("altitude",)  # reported, not fitted: it adds wind and pressure errors to what attitude and alpha tell already
DRAWS = 40  # of the posterior, for the probability of staying inside the tolerances
UNKNOWN = 10.0  # times the joint fit's deviation from which a manoeuvre says nothing of a cause

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Error:
    """One output of one manoeuvre: root mean square and largest error (SI), Theil's coefficient and its parts.

    `within` is the share of samples inside the tolerance, `probability` the posterior's that all of them are.
    """

    rms: float
    largest: float
    theil: TheilParts
    tolerance: float | None
    within: float | None
    probability: float | None


@dataclass(frozen=True)
class Path:
    """One simulated manoeuvre. `split` is fitted (jointly, initial state too) or unseen (from the measured state)."""

    manoeuvre: str
    model: str  # card or extended
    split: str
    inside: bool  # the flight envelope
    errors: Mapping[str, Error]
    time: Float[np.ndarray, " n"]
    measured: Mapping[str, np.ndarray]
    simulated: Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Trajectories:
    """What simulations say of the card's model and of the extended one."""

    paths: tuple[Path, ...]
    card: OutputErrorResult
    extended: OutputErrorResult
    deviation: Float[np.ndarray, " k"]  # of the extended model's parameters, the residuals' colour counted
    colour_cost: float  # how many times the colour multiplies variances
    held: Mapping[str, tuple[str, ...]]  # causes held at their joint estimate when a manoeuvre is fitted alone
    outputs: tuple[str, ...]

    def path(self, manoeuvre: str, model: str, split: str) -> Path | None:
        """One of the paths."""
        return next((p for p in self.paths if (p.manoeuvre, p.model, p.split) == (manoeuvre, model, split)), None)


def fly_both(
    flights: Flights,
    diagnosis: Diagnosis,
    tolerances: Mapping[str, float],
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Trajectories:
    """Fit the card's model and the extended one to the trajectories, jointly and with each manoeuvre left out."""
    field = diagnosis.aerodynamics.state.field
    causes = [c.name for c in diagnosis.causes]
    added = [e for e in field.model.effects if e.name in causes]
    base = [e for e in field.model.effects if e.name in field.base or not e.parameters]
    found = dict(zip(field.model.names, diagnosis.theta, strict=True))
    before = dict(zip(field.model.names, diagnosis.aerodynamics.base.theta, strict=True))
    model = _extended(field.model, [*base, *added])
    ours = _side(model, flights, {name: found[name] for name in model.names})
    neutral = {p.name: field.neutral[p.name] for e in added for p in e.parameters if p.name in model.names}
    theirs = replace(ours, start=np.array([neutral.get(name, before[name]) for name in model.names]))
    if any(e.stage is Stage.LAG for e in added):  # a state that the card's model does not have
        bare = _extended(field.model, base)
        theirs, neutral = _side(bare, flights, {name: before[name] for name in bare.names}), {}

    def tell(text: str, share: float) -> None:
        if progress:
            progress(f"trajectories: {text}", share)

    tell("extended model", 0.0)
    joint = fit_cascade([ours.window, ours.whole], [ours.start], prior_weight=BEGIN_COST)
    cost, _ = colour_cost(joint)
    joint = fit_output_error(ours.whole, start=joint.estimate, departure=joint.departure, prior_weight=cost)
    tell("card's model", 0.3)
    card = fit_cascade([theirs.window, theirs.whole], [theirs.start], held=neutral, prior_weight=cost)
    own = {p.name for e in added for p in e.parameters}
    paths, held = [], {}
    for name, fit in (("card", card), ("extended", joint)):
        paths += _paths(fit, fit.flown, name, "fitted", fit.departure, tolerances)
    count = len(ours.whole.index)
    for k in range(count):
        tell("left out", 0.5 + 0.4 * k / count)
        rest = [i for i in range(count) if i != k]
        values = dict(zip(joint.names, joint.estimate, strict=True))
        silent = {n: float(values[n]) for n in _silent(joint, _masked(ours.whole, rest)) if n in own}
        held[_label(ours.whole, k)] = tuple(silent)
        for name, fit, kept in (("card", card, neutral), ("extended", joint, silent)):
            again = fit_output_error(_masked(fit.flown, rest), start=fit.estimate, held=kept, prior_weight=cost)
            seen, still = _masked(fit.flown, [k]), np.zeros_like(fit.departure)
            paths += _paths(again, seen, name, "unseen", still, tolerances, cost, seed)
    deviation = np.sqrt(np.diag(_covariance(joint, cost)))
    shown = tuple(n for n in ours.whole.dynamics.outputs if n in flights.channels)
    return Trajectories(tuple(paths), card, joint, deviation, cost, held, shown)


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


def _masked(flown: Flown, rows: Sequence[int]) -> Flown:
    """Only some of the segments count; the shapes stay, so nothing compiles anew."""
    keep = np.isin(np.arange(len(flown.index)), list(rows))
    return eqx.tree_at(lambda f: f.inside, flown, flown.inside & keep[:, None])


def _label(flown: Flown, row: int) -> str:
    name = flown.flights.names[int(flown.manoeuvre[row])]
    if len(flown.flights.lengths) > 1:
        return name
    return f"{name}, {'first' if row == 0 else 'second'} half"


def colour_cost(fit: OutputErrorResult) -> tuple[float, Float[np.ndarray, " k"]]:
    """How many times the residuals' colour multiplies the parameters' variances: median, and each.

    From Morelli and Klein's corrected covariance on means over `THINNED` samples (of white residuals a fifth of the
    variance is left there); the segments' states are among the parameters.
    """
    flown, k = fit.flown, len(fit.estimate)
    residual, S = fit.thinned[..., 0], fit.thinned[..., 1:]
    m = S.shape[1]
    inside = flown.inside[:, : m * THINNED].reshape(len(S), m, THINNED).all(axis=2)
    w, n, c, wide = S.shape
    own = np.zeros((w, n, c, k + w * (wide - k)))
    own[..., :k] = S[..., :k]
    for row in range(w):
        begin = k + row * (wide - k)
        own[row, :, :, begin : begin + wide - k] = S[row, :, :, k:]
    keep = inside.ravel()
    flat, r = own.reshape(w * n, c, -1)[keep], residual.reshape(w * n, c)[keep]
    start = np.concatenate([[True], np.diff(np.repeat(np.arange(w), n)[keep]) != 0])
    information = np.einsum("nci,c,ncj->ij", flat, 1.0 / fit.R, flat, optimize=True)
    used = np.diag(information) > 0.0
    scale = np.sqrt(np.diag(information)[used])
    D = np.linalg.pinv(information[np.ix_(used, used)] / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    D = D / np.outer(scale, scale)
    corrected = corrected_covariance(D, flat[:, :, used], fit.R, r, np.repeat(np.arange(w), n)[keep], start)
    ratio = np.full(k, np.nan)
    places = np.flatnonzero(used[:k])
    ratio[places] = (np.diag(corrected) / np.diag(D))[: len(places)]
    return max(1.0, THINNED * float(np.nanmedian(ratio))), ratio * THINNED


def _covariance(fit: OutputErrorResult, cost: float) -> Float[np.ndarray, "k k"]:
    """Of the parameters, under a likelihood that counts each sample for one in `cost`, and their priors."""
    return cost * fit.covariance


def _silent(joint: OutputErrorResult, others: Flown) -> list[str]:
    """Parameters of which the segments that are left say less than a hundredth of what all say."""
    part = fit_output_error(others, start=joint.estimate, departure=joint.departure, most=0)
    alone = part.crb
    with np.errstate(invalid="ignore"):
        return [n for n, a, b in zip(joint.names, alone, joint.crb, strict=True) if not a < UNKNOWN * b]


def _paths(
    fit: OutputErrorResult,
    flown: Flown,
    model: str,
    split: str,
    departure: Float[np.ndarray, "w s"],
    tolerances: Mapping[str, float],
    cost: float = 1.0,
    seed: int = 0,
) -> list[Path]:
    """Every segment of `flown` that counts, simulated with the parameters of `fit`."""
    shown = tuple(n for n in flown.dynamics.outputs if n in flown.flights.channels)
    wide = replace(flown, outputs=shown)
    theta = jnp.asarray(fit.estimate)
    found = trajectories(wide, theta, jnp.asarray(departure))
    probability: Mapping[tuple[int, str], float] = {}
    if split == "unseen" and fit.status is not OutputErrorStatus.LEFT_ENVELOPE:
        probability = _probabilities(fit, wide, tolerances, cost, seed)
    paths = []
    for row in map(int, np.flatnonzero(flown.inside.any(axis=1))):
        keep = flown.inside[row]
        measured, residual = np.asarray(found.measured[row])[keep], np.asarray(found.residual[row])[keep]
        errors = {
            name: _error(measured[:, c], residual[:, c], tolerances.get(name), probability.get((row, name)))
            for c, name in enumerate(shown)
        }
        index = flown.index[row][keep]
        paths.append(
            Path(
                manoeuvre=_label(flown, row),
                model=model,
                split=split,
                inside=bool(np.asarray(found.trajectory.inside[row])[keep].all()),
                errors=errors,
                time=flown.flights.time[index],
                measured={name: measured[:, c] for c, name in enumerate(shown)},
                simulated={name: measured[:, c] - residual[:, c] for c, name in enumerate(shown)},
            )
        )
    return paths


def _error(measured: np.ndarray, residual: np.ndarray, tolerance: float | None, probability: float | None) -> Error:
    size = np.abs(residual)
    return Error(
        rms=float(np.sqrt(np.mean(residual**2))),
        largest=float(size.max()),
        theil=theil_parts(measured, measured - residual),
        tolerance=tolerance,
        within=None if tolerance is None else float(np.mean(size <= tolerance)),
        probability=probability,
    )


@eqx.filter_jit
def _drawn(flown: Flown, thetas: Float[Array, "m k"], departure: Float[Array, "w s"]):
    """Largest error of every segment and output for each draw: (m, w, c); infinite outside the envelope."""

    def one(theta):
        found = simulate(flown, theta, departure)
        inside = jnp.all(found.trajectory.inside | ~flown.inside, axis=1)
        largest = jnp.max(jnp.abs(found.residual), axis=1)
        return jnp.where(inside[:, None] & jnp.isfinite(largest), largest, jnp.inf)

    return jax.lax.map(one, thetas)


def _probabilities(
    fit: OutputErrorResult, flown: Flown, tolerances: Mapping[str, float], cost: float, seed: int
) -> dict[tuple[int, str], float]:
    """Share of posterior draws whose whole trajectory stays inside each tolerance."""
    moving = np.flatnonzero(fit.sd > 0.0)
    covariance = _covariance(fit, cost)[np.ix_(moving, moving)]
    scale = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    white = np.random.default_rng(seed).standard_normal((DRAWS, len(moving)))
    thetas = np.tile(fit.estimate, (DRAWS, 1))
    thetas[:, moving] += (white * np.sqrt(np.maximum(values, 0.0))) @ vectors.T * scale
    lower, upper = (np.array([p.bounds[i] for p in fit.parameters], float) for i in (0, 1))
    largest = np.asarray(
        _drawn(
            flown, jnp.asarray(np.clip(thetas, lower, upper)), jnp.zeros((len(flown.index), len(flown.dynamics.states)))
        )
    )
    return {
        (row, name): float(np.mean(largest[:, row, c] <= tolerances[name]))
        for row in range(largest.shape[1])
        for c, name in enumerate(flown.outputs)
        if name in tolerances
    }
