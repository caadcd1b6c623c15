"""Where the criticism stands: parameters, which effects are in, and the problem linearised there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from bayes_aero.diagnosis.candidate_set import CandidateModel, folds_of
from bayes_aero.diagnosis.screening.regression import Products, RegressionFit
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.parameter import departure
from bayes_aero.physics.filters import FILTER_STEP
from bayes_aero.residuals.base import ResidualModel

TINY = 1e-300
WIDE = 10.0  # times the residual's deviation, the prior one of an offset of a manoeuvre
LARGEST = 1e100  # of a sensitivity: a simulation that has diverged says nothing, and its square has no number


@dataclass(frozen=True)
class Scan:
    """One value at which a candidate without a slope at neutral is tried."""

    effect: str
    parameter: str
    value: float


@dataclass(frozen=True)
class Component:
    """A function of a `channel` (or of time, or a term) in a `coefficient`, that is no effect of the catalogue."""

    coefficient: str
    channel: str
    basis: Float[np.ndarray, "m c w"]  # what it adds to each output

    @property
    def label(self) -> str:
        """What it is called beside others."""
        return f"{self.coefficient} over {self.channel}"


@dataclass(frozen=True)
class SelectionState:
    """Parameters `theta` (all of the full model's), residuals and sensitivities there.

    Outputs are those of one stage of the criticism: the coefficients, or the flight path. Columns beyond the
    parameters: the flight-path offsets, active always; a column for every scanned value of a candidate that has no
    slope at neutral; and a last one of zeros, which fills up blocks of unequal width.
    """

    full: CandidateModel
    responses: ResidualModel
    outputs: tuple[str, ...]
    theta: Float[np.ndarray, " k"]
    residual: Float[np.ndarray, "m c"]
    S: Float[np.ndarray, "m c K"]
    noise_growth: Float[np.ndarray, "m c"]
    folds: tuple[slice, ...]
    products: Products
    mean: Float[np.ndarray, " K"]
    precision: Float[np.ndarray, " K"]
    active: tuple[str, ...]  # names of the effects that are in, beyond the card's
    scans: tuple[Scan, ...]
    nuisance: int = 0  # columns between the parameters and the scans
    variance_inflation: float = 1.0  # priors count so many times against the white likelihood
    apart: tuple[str, ...] = ()  # coefficients with a constant of their own in every manoeuvre, among the nuisance
    components: tuple[Component, ...] = ()  # candidates in place of effects
    chosen: tuple[Component, ...] = ()  # components that are in

    @property
    def settings(self) -> DiagnosisSettings:
        """Thresholds of the diagnosis."""
        return self.full.settings

    def least_share(self, share: float) -> float:
        """A least share of the variance of means over `FILTER_STEP` samples, as of these: noise averages out."""
        return share * self.responses.averaged / FILTER_STEP

    @cached_property
    def kept_outputs(self) -> list[int]:
        """Places of the outputs among those of the responses."""
        return [self.responses.outputs.index(name) for name in self.outputs]

    @property
    def departure(self) -> Float[np.ndarray, " k"]:
        """How far each parameter is from neutral, to first order (see `departure`)."""
        away = [departure(x, p.neutral) for x, p in zip(self.theta, self.full.model.free, strict=True)]
        return np.where(self.theta == self.full.neutral_vector, 0.0, away)

    @cached_property
    def inside(self) -> Bool[np.ndarray, " m"]:
        """Blocks that belong to a fold: neither products nor fits have seen the others."""
        found = np.zeros(len(self.S), bool)
        for fold in self.folds:
            found[fold] = True
        return found

    @property
    def offsets(self) -> Int[np.ndarray, " o"]:
        """Columns of what is free in every fit and no parameter."""
        return len(self.theta) + np.arange(self.nuisance)

    @property
    def begins(self) -> Int[np.ndarray, " o"]:
        """Those of `offsets` with which integrals, windows or simulations begin."""
        return self.offsets[: self.nuisance - len(self.apart) * len(self.responses.flights.lengths)]

    @property
    def scanned(self) -> dict[Scan, Float[np.ndarray, "m c 1"]]:
        """Sensitivity to each scanned value."""
        begin = len(self.theta) + self.nuisance
        return {scan: self.S[:, :, begin + i : begin + i + 1] for i, scan in enumerate(self.scans)}

    @property
    def component_columns(self) -> list[Int[np.ndarray, " w"]]:
        """Columns of each component that is a candidate."""
        widths = [c.basis.shape[2] for c in (*self.chosen, *self.components)]
        begins = len(self.theta) + self.nuisance + len(self.scans) + np.cumsum([0, *widths])
        return [np.arange(a, b) for a, b in pairwise(begins)][len(self.chosen) :]

    @property
    def blocks(self) -> list[tuple[str, Int[np.ndarray, " w"], float | None]]:
        """Every way in which a candidate that reaches the outputs may enter: name, columns, and any scanned value."""
        if self.components:
            return [(c.label, own, None) for c, own in zip(self.components, self.component_columns, strict=True)]
        begin, scanned = len(self.theta) + self.nuisance, {scan.effect for scan in self.scans}
        found: list[tuple[str, np.ndarray, float | None]] = [
            (scan.effect, np.array([begin + number]), scan.value) for number, scan in enumerate(self.scans)
        ]
        names = (effect.name for effect in self.full.candidates if effect.name not in scanned)
        found += [(name, self.full.own_columns(name), None) for name in names]
        return [block for block in found if np.any(self.S[:, :, block[1]] != 0.0)]

    def columns(self, effects: Sequence[str] | None = None) -> Int[np.ndarray, " a"]:
        """Columns of the card's effects, of `effects` (default: those that are in), and the offsets."""
        names = (*self.full.base, *(self.active if effects is None else effects))
        own = self.full.columns([p for n in names for p in self.full.parameters_of(n) if p in self.full.model.names])
        begin = len(self.theta) + self.nuisance + len(self.scans)
        chosen = begin + np.arange(sum(c.basis.shape[2] for c in self.chosen))
        return np.concatenate([own[np.any(self.S[:, :, own] != 0.0, axis=(0, 1))], self.offsets, chosen])

    def wider(self, columns: Sequence[int] | np.ndarray) -> Int[np.ndarray, " k"]:
        """The active columns and these."""
        return np.concatenate([self.columns(), np.array(columns, int)])

    def fit(self) -> RegressionFit:
        """Regression with the effects that are in on all folds."""
        return self.fit_columns(self.columns())

    def fit_columns(self, columns: Int[np.ndarray, " k"], held: Float[np.ndarray, " c"] | None = None) -> RegressionFit:
        """Regression with these columns on all folds; with variances it finds, or `held` ones."""
        return self.products.fit(columns, self.mean, self.precision, held)

    def left(self, fit: RegressionFit) -> Float[np.ndarray, "m c"]:
        """Residuals that a fit leaves, divided by the noise_growth."""
        return (self.residual - self.S[:, :, fit.columns] @ fit.step) / self.noise_growth

    def with_components(
        self, components: Sequence[Component], chosen: Sequence[Component], folds: Sequence[slice] | None = None
    ) -> SelectionState:
        """The state in which components are the candidates in place of effects; those `chosen` are in."""
        folds, extra = self.folds if folds is None else folds, [c.basis for c in (*chosen, *components)]
        S = np.concatenate([self.S[:, :, :-1], *extra, self.S[:, :, -1:]], axis=2)
        width, size = S.shape[2] - self.S.shape[2], float(np.median(np.std(self.residual / self.noise_growth, axis=0)))
        flat = np.full(width, self.variance_inflation / (10 * size) ** 2)
        precision = np.concatenate([self.precision[:-1], flat, [1.0]])
        mean = np.concatenate([self.mean[:-1], np.zeros(width), [0.0]])
        products = Products.of(self.residual / self.noise_growth, S / self.noise_growth[:, :, None], folds)
        return replace(
            self, S=S, mean=mean, precision=precision, products=products, folds=tuple(folds),
            components=tuple(components), chosen=tuple(chosen),
        )  # fmt: skip

    def share_of(self, own: Int[np.ndarray, " k"]) -> float:
        """Share of a coefficient's remaining variance that columns take away, at best over the coefficients."""
        return float(np.max(1.0 - self.fit_columns(self.wider(own)).variance / self.fit().variance))

    def without(self, effects: Sequence[str]) -> SelectionState:
        """The state with some of its additions at neutral, to first order."""
        if not effects:
            return self
        own = self.full.own_columns(*effects)
        away, theta, mean = self.departure[own], self.theta.copy(), self.mean.copy()
        theta[own], mean[own] = self.full.neutral_vector[own], mean[own] + away
        residual = self.residual + self.S[:, :, own] @ away
        active = tuple(e for e in self.active if e not in effects)
        products = self.products.shifted(own, -away)
        return replace(self, theta=theta, mean=mean, residual=residual, products=products, active=active)

    @cached_property
    def scaled(self) -> Float[np.ndarray, "m c K"]:
        """Sensitivities divided by the noise_growth."""
        return self.S / self.noise_growth[:, :, None]


def linearised(
    full: CandidateModel,
    responses: ResidualModel,
    outputs: tuple[str, ...],
    theta: Float[np.ndarray, " k"],
    active: tuple[str, ...] = (),
    noise_growth: Float[np.ndarray, "m c"] | None = None,
    variance_inflation: float = 1.0,
    known: SelectionState | None = None,
    apart: tuple[str, ...] = (),
) -> SelectionState:
    """The state at `theta`: residuals, sensitivities to every parameter, and their inner products.

    Candidates that are not active and have no slope at neutral are tried at their scanned values. What is `known` of
    the same responses at the same parameters is not computed again. Coefficients `apart` have an offset in every
    manoeuvre, free in every fit.
    """

    keep = [responses.outputs.index(name) for name in outputs]
    if known is not None and np.array_equal(known.theta, theta):
        residual, S, scanned = known.residual, known.S[:, :, : len(theta)], known.scanned
    else:
        residual, S = responses.linearise(theta)
        residual, S, scanned = residual[:, keep], S[:, keep], {}
    constants = [constants_of_manoeuvres(full, responses.manoeuvre, outputs, S, name) for name in apart]
    scans, extra = [], [np.concatenate([responses.offsets(theta, outputs), *constants], axis=2)]
    for effect in full.candidates:
        if effect.name in active:
            continue
        for name, values in effect.scan.items():
            at = int(full.columns([name])[0])
            for value in values:
                scans.append(Scan(effect.name, name, value))
                if scans[-1] in scanned:
                    extra.append(scanned[scans[-1]])
                    continue
                there = theta.copy()
                there[at] = value
                other = np.asarray(responses.evaluate(there)[0])[:, keep]
                extra.append(((residual - other) / (value - theta[at]))[:, :, None])
    S = np.concatenate([S, *extra, np.zeros((*residual.shape, 1))], axis=2)
    S = np.where(np.abs(S) < LARGEST, S, 0.0)
    noise_growth = np.ones_like(residual) if noise_growth is None else noise_growth
    folds = folds_of(responses.manoeuvre, responses.seconds, full.settings)
    mean, precision = full.prior(range(len(theta)), theta)
    precision = variance_inflation * precision
    of_scans = [int(full.columns([s.parameter])[0]) for s in scans]
    nothing = np.zeros(extra[0].shape[2])
    # Nearly flat: the constants add up to about zero, and the model's own constant stays what it is in the mean.
    size = [_spread(residual, ones) for S in constants for ones in np.moveaxis(S, 2, 0)]
    flat = np.concatenate(
        [nothing[len(size) :], variance_inflation / np.square(np.maximum(WIDE * np.array(size), TINY))]
    )
    mean = np.concatenate([mean, nothing, mean[of_scans], [0.0]])
    precision = np.concatenate([precision, flat, precision[of_scans], [1.0]])
    products = Products.of(residual / noise_growth, S / noise_growth[:, :, None], folds)
    return SelectionState(
        full, responses, outputs, theta, residual, S, noise_growth, folds, products, mean, precision, active,
        tuple(scans), extra[0].shape[2], variance_inflation, apart,
    )  # fmt: skip


def _spread(residual: Float[np.ndarray, "m c"], ones: Float[np.ndarray, "m c"]) -> float:
    """The size of a constant that moves the outputs by the deviation of their residuals."""
    here = np.any(ones != 0.0, axis=1)
    moved = np.mean(ones[here] ** 2, axis=0) if here.any() else np.zeros(ones.shape[1])
    return 1.0 / max(float(np.sqrt(np.sum(moved / np.maximum(np.var(residual, axis=0), TINY)))), TINY)


def constants_of_manoeuvres(
    full: CandidateModel,
    manoeuvre: Int[np.ndarray, " m"],
    outputs: Sequence[str],
    S: Float[np.ndarray, "m c k"],
    name: str,
) -> Float[np.ndarray, "m c o"]:
    """Sensitivity to a coefficient's constant in every manoeuvre: of itself, or of flown outputs to the model's one."""
    if name in outputs:
        return manoeuvre_constants(manoeuvre, outputs, name)
    here = manoeuvre[:, None] == np.arange(int(manoeuvre[-1]) + 1)
    column = np.where(np.abs(S) < LARGEST, S, 0.0)[:, :, full.columns([constant_of(name)])]
    return column * here[:, None, :]


def constant_of(coefficient: str) -> str:
    """The parameter that is a coefficient's constant."""
    return f"{coefficient}0"


def manoeuvre_constants(
    manoeuvre: Int[np.ndarray, " m"], outputs: Sequence[str], name: str
) -> Float[np.ndarray, "m c o"]:
    """A column of ones in one output for every manoeuvre."""
    S = np.zeros((len(manoeuvre), len(outputs), int(manoeuvre[-1]) + 1))
    S[np.arange(len(manoeuvre)), outputs.index(name), manoeuvre] = 1.0
    return S


def moved(
    state: SelectionState,
    theta: Float[np.ndarray, " k"],
    active: tuple[str, ...] | None = None,
    apart: tuple[str, ...] | None = None,
) -> SelectionState:
    """The state at other parameters, with other effects in or coefficients `apart`, with the same noise growth."""
    active, apart = state.active if active is None else active, state.apart if apart is None else apart
    noise = state.noise_growth, state.variance_inflation
    return linearised(state.full, state.responses, state.outputs, theta, active, *noise, state, apart)
