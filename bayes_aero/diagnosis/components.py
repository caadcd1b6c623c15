"""Functions that are candidates in place of effects: smooth ones of channels, periods, terms of the library."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis import screening, selection_state
from bayes_aero.diagnosis.result import ParameterChange, ProductTerm, TermFactor
from bayes_aero.diagnosis.selection import holdout_deviance_gain
from bayes_aero.diagnosis.selection_state import Component, RegressionFit, SelectionState, inverse, manoeuvres, moves
from bayes_aero.effect import Kind, Stage
from bayes_aero.flight.health import noise_of
from bayes_aero.inference.covariance import ORDER, nats
from bayes_aero.physics.aircraft import LATERAL, Aircraft
from bayes_aero.physics.kinematics import reduced, reduced_lateral
from bayes_aero.residuals.base import Signals

Rows = Float[np.ndarray, "m c"]
Columns = Int[np.ndarray, " k"]
Folds = Sequence[slice]

# --- Terms that nobody listed: products, breaks, bumps, what acts in separated flow alone, memory.
# A term is a product of factors. A factor is a nondimensional quantity of the flight, a function of the angle of
# attack, the separated share 1 - X, or a quantity as it was some chords ago.

MOST_FACTORS = 3  # most factors of a product
BREAKS = tuple(k / 20.0 for k in range(1, 20))  # quantiles of alpha or beta at which its effect may break
BUMPS = tuple(k / 10.0 for k in range(1, 10))  # and at which it may have a bump
WIDTHS = (0.07, 0.12, 0.2)  # of a bump, shares of the range
CLEAR = 3.0  # standard deviations of its noise; nearer to zero, noise decides the sign and makes a dead band
LAGS = (5.0, 15.0, 40.0, 100.0)  # chords travelled, time constants of memory


def _channel(name: str, *, lateral: bool = False) -> TermFactor:
    unit = "1" if name == "mach" else "rad"
    return TermFactor(name, f's["{name}"]', (name,), lambda s, _: np.asarray(s[name]), lateral, unit=unit)


def _rate(name: str, channel: str, *, lateral: bool = False) -> TermFactor:
    by = reduced_lateral if lateral else reduced
    code = f'{by.__name__}(s["{channel}"], s["airspeed"], a)'
    evaluate = lambda s, a: np.asarray(by(s[channel], s["airspeed"], a))  # noqa: E731
    return TermFactor(name, code, (channel, "airspeed"), evaluate, lateral)


THRUST = TermFactor(
    "CT",
    's["thrust"] / (0.5 * s["density"] * s["airspeed"] ** 2 * a.wing_area)',
    ("thrust", "density", "airspeed"),
    lambda s, a: np.asarray(s["thrust"] / (0.5 * s["density"] * s["airspeed"] ** 2 * a.wing_area)),
)
SEPARATED = TermFactor("(1 - X)", '(1.0 - known["X"])', (), lambda s, _: 1.0 - np.asarray(s["X"]))
QUANTITIES = (
    _channel("alpha"), _rate("qhat", "q"), _channel("elevator"), _channel("stabilizer"), _channel("flap"),
    _channel("spoiler"), _channel("dlc"), _channel("canard"), _channel("mach"), THRUST,
    _channel("beta", lateral=True), _rate("phat", "p", lateral=True), _rate("rhat", "r", lateral=True),
    _channel("aileron", lateral=True), _channel("rudder", lateral=True),
)  # fmt: skip
MEMORY = ("alpha", "beta", "elevator", "aileron", "rudder")
"""Quantities of which the past may matter. Not a rate: with its past it is its own derivative, which is the moment."""
CURVED = ("alpha", "beta")  # quantities whose own effect may break; that of alpha may have a bump


def _beyond(quantity: TermFactor, at: float) -> str:
    return f"{quantity.name} {'-' if at >= 0.0 else '+'} {abs(at):g}"


def _break(quantity: TermFactor, at: float) -> TermFactor:
    """What the quantity is beyond a value, on either side if `lateral`: its slope is another one there."""
    expression, lateral = quantity.code, quantity.lateral
    code = f"xp.maximum({f'xp.abs({expression})' if lateral else expression} - {at!r}, 0.0)"
    name = f"max({_beyond(quantity, at)}, 0)"
    if lateral:
        name, code = f"sign({quantity.name}) max(|{quantity.name}| - {at:g}, 0)", f"xp.sign({expression}) * {code}"

    def evaluate(s: Signals, a: Aircraft) -> Float[np.ndarray, " n"]:
        x = quantity.evaluate(s, a)
        return np.sign(x) * np.maximum(np.abs(x) - at, 0.0) if lateral else np.maximum(x - at, 0.0)

    return TermFactor(name, code, quantity.channels, evaluate, lateral, 2, quantity.unit)


def _bump(quantity: TermFactor, at: float, width: float) -> TermFactor:
    code = f"xp.exp(-0.5 * (({quantity.code} - {at!r}) / {width!r}) ** 2)"
    name = f"exp(-(({_beyond(quantity, at)})/{width:g})^2/2)"
    return TermFactor(
        name, code, quantity.channels,
        lambda s, a: np.exp(-0.5 * ((quantity.evaluate(s, a) - at) / width) ** 2), quantity.lateral, 3,
    )  # fmt: skip


def _lagged(quantity: TermFactor, chords: float) -> TermFactor:
    """The quantity as a first-order lag of so many chords passes it, at the median airspeed."""

    def evaluate(s: Signals, a: Aircraft) -> Float[np.ndarray, " n"]:
        from scipy.signal import lfilter  # slow to load, and `check` needs none

        x, first = quantity.evaluate(s, a), np.unique(np.asarray(s["first"]))
        dt, speed = float(np.median(np.asarray(s["dt"]))), float(np.median(np.asarray(s["airspeed"])))
        keep = np.exp(-dt * speed / (chords * a.chord))
        parts = np.split(x, first[1:].astype(int))
        return np.concatenate([lfilter([1.0 - keep], [1.0, -keep], p, zi=[keep * p[0]])[0] for p in parts])

    name = f"lag({quantity.name}, {chords:g} c/V)"
    return TermFactor(name, None, quantity.channels, evaluate, quantity.lateral, 2, quantity.unit)


def library(
    signals: Signals, aircraft: Aircraft, able: Callable[[str], bool], *, lateral: bool, separated: bool
) -> tuple[ProductTerm, ...]:
    """Terms of a coefficient that these flights can tell, which change sign with the wings as it does (`lateral`)."""
    quantities = [q for q in QUANTITIES if all(map(able, q.channels))]
    factors = [*quantities, *([SEPARATED] if separated else [])]
    products = [ProductTerm(t) for k in range(1, MOST_FACTORS + 1) for t in combinations_with_replacement(factors, k)]
    terms = [t for t in products if t.factors.count(SEPARATED) <= 1]
    for q in quantities:
        x = q.evaluate(signals, aircraft)
        if q.name in CURVED:
            least = CLEAR * noise_of(*np.split(x, np.unique(np.asarray(signals["first"]))[1:].astype(int)))
            places = [at for at in _places(np.abs(x), BREAKS) if at > least] if q.lateral else _places(x, BREAKS)
            terms += [ProductTerm((_break(q, at),)) for at in places]
        if q.name in CURVED and not q.lateral:
            reach = float(np.ptp(np.quantile(x, (0.02, 0.98))))
            widths = [float(np.round(share * reach, 4)) for share in WIDTHS]
            terms += [ProductTerm((_bump(q, at, w),)) for at in _places(x, BUMPS) for w in widths if w > 0.0]
        if q.name in MEMORY:
            terms += [ProductTerm((_lagged(q, chords),)) for chords in LAGS]
    return tuple(t for t in terms if (sum(f.lateral for f in t.factors) % 2 == 1) == lateral)


def _places(x: Float[np.ndarray, " n"], shares: Sequence[float]) -> list[float]:
    return list(dict.fromkeys(float(np.round(q, 3)) for q in np.quantile(x, shares)))


# --- Components: functions of channels, periods and terms in a regression.

ODD = ("beta", "p", "r", "aileron", "rudder")
SKIPPED = ("ax", "ay", "az", "p_dot", "q_dot", "r_dot", "alpha_dot")  # responses themselves, not causes
SEPARATES = 0.9  # X below which a flight tells what acts in separated flow alone; our choice
DEGREES = 4  # columns of a polynomial of the angle of attack; our choice
SAME = 0.999  # squared cosine of what an effect and a term do to a coefficient, beyond which they are one; our choice
BYTES = 2e9  # of memory that inner products may take


def families(state: SelectionState) -> tuple[tuple[list[Component], float], ...]:
    """Functions of channels and terms that the record can test, and the least share of each kind."""
    s, alone = state.settings, len(state.responses.flights.lengths) == 1
    least = s.single_share if alone else s.unnamed_share
    terms = [column.component for name in state.outputs for column in columns_of(state, name)]
    return (smooth_components(state), least), (terms, least)


def smooth_components(state: SelectionState) -> list[Component]:
    """A smooth function, in each coefficient, of every recorded channel that moves and is more than white noise."""
    signals, flights, knots = state.responses.predict(state.theta), state.responses.flights, state.settings.knots
    skipped = (*SKIPPED, *selection_state.noise_channels(flights))
    names = [n for n in (*flights.recorded, "elapsed", "X") if n in signals and n not in skipped]
    components = []
    for name in (n for n in names if moves(signals[n], flights, 1e-6)):
        x = np.asarray(state.responses.block(signals[name]))
        either, even = (_smooth(y, knots) for y in (x, np.abs(x) if name in ODD else x))
        components += _in_each(state, name, {c: either if c in LATERAL else even for c in state.outputs})
    return components


def _smooth(x: Float[np.ndarray, " m"], count: int) -> Float[np.ndarray, "m w"]:
    """A line and radial bumps between quantiles, scaled to unit deviation; constants belong to the model."""
    knots = np.quantile(x, np.linspace(0.02, 0.98, count))
    width = max((knots[-1] - knots[0]) / (count - 1), 1e-12)
    B = np.stack([x - x.mean(), *(np.exp(-0.5 * ((x - k) / width) ** 2) for k in knots[1:-1])], axis=1)
    B = B - B.mean(axis=0)
    return B / np.maximum(B.std(axis=0), 1e-12)


def _in_each(state: SelectionState, channel: str, columns: dict[str, Float[np.ndarray, "m w"]]) -> list[Component]:
    components = []
    for coefficient, column in columns.items():
        basis = np.zeros((len(column), len(state.outputs), column.shape[1]))
        basis[:, state.outputs.index(coefficient)] = column
        components.append(Component(coefficient, channel, basis))
    return components


def offsets_left(state: SelectionState, *, seed: int) -> tuple[str, ...]:
    """Coefficients whose mean residual differs between manoeuvres beyond chance, as that of a function must."""
    left, settings = [c for c in state.outputs if c not in state.apart], state.settings
    if len(state.responses.flights.lengths) == 1 or not left or not has_chunks(state):
        return ()
    folds, of = chunks(state), (state.full, state.responses.manoeuvre, state.outputs, state.S)
    components = [Component(c, "manoeuvre", selection_state.constants_of_manoeuvres(*of, c)[:, :, 1:]) for c in left]
    whole, differing = state.with_components(components, (), folds), []
    for component in components:
        trial = Trial(state, component, (), folds)
        enough = trial.share >= settings.unnamed_share and trial.gain > 0.0
        if enough and trial.chance([whole], seed) <= settings.unnamed_false_alarm_rate:
            differing.append(component.coefficient)
    return tuple(differing)


def parts_of(state: SelectionState, count: int) -> tuple[slice, ...]:
    """Every manoeuvre in `count` parts, some blocks between neighbours left out."""
    edges = [np.flatnonzero(state.responses.manoeuvre == k) for k in range(len(state.responses.flights.lengths))]
    parts = [part for e in edges for part in np.array_split(e, count)]
    return tuple(slice(int(p[0]) + 2, int(p[-1]) - 1) for p in parts)


def chunks(state: SelectionState) -> tuple[slice, ...]:
    return parts_of(state, state.settings.manoeuvre_parts)


def has_chunks(state: SelectionState) -> bool:
    """Whether every manoeuvre is long enough for a sinusoid to be fitted to parts of it and predict the others."""
    return all(part.stop - part.start > ORDER for part in chunks(state))


def in_batches(state: SelectionState, components: Sequence[Component]) -> list[list[Component]]:
    """The components in as few sets as memory allows: inner products of all columns grow with their number squared."""
    each = 8.0 * len(state.folds) * state.residual.shape[1]  # bytes of one pair of columns
    most, batches, width = max(int(np.sqrt(BYTES / each)) - state.S.shape[2], 1), list[list[Component]](), 0
    for component in components:
        if not batches or width + component.basis.shape[2] > most:
            batches.append([])
            width = 0
        batches[-1].append(component)
        width += component.basis.shape[2]
    return batches or [[]]


class Trial:
    """A component as the only candidate beside those `chosen`, and the fit with it in."""

    def __init__(
        self, state: SelectionState, component: Component, chosen: Sequence[Component] = (), folds: Folds | None = None
    ) -> None:
        self.state = state.with_components((component,), chosen, folds)
        self.wide = self.state.wider(self.state.component_columns[0])

    @cached_property
    def fit(self) -> RegressionFit:
        return self.state.fit(self.wide)

    @cached_property
    def share(self) -> float:
        return float(np.max(1.0 - self.fit.variance / self.state.best.variance))

    @cached_property
    def gain(self) -> float:
        return holdout_deviance_gain(self.state, self.wide)

    def chance(self, among: Sequence[SelectionState], seed: int) -> float:
        """How often noise of the colour that is left alone lets some component of these explain as large a share."""
        colour = screening.autocorrelation_of(self.state.left(self.fit), self.state.folds)
        nulls = [screening.null_shares(x, colour, self.fit.variance, seed) for x in among]
        return screening.chance_of(self.share, np.max(nulls, axis=0))


@dataclass(frozen=True)
class TermColumn:
    """A term of one coefficient as these flights show it."""

    term: ProductTerm
    component: Component  # what `scale` times the term adds to the residuals, about as large as these
    scale: float
    spread: float  # the term's own deviation


def columns_of(state: SelectionState, coefficient: str, given: Sequence[ProductTerm] = ()) -> list[TermColumn]:
    """The library's terms in one coefficient, or those `given`, as the residuals show them to first order."""
    added, flights = state.added, state.responses.flights
    signals = added.signals
    if given:  # a simulation has no channel that its model does not read
        terms = [term for term in given if all(channel in signals for channel in term.channels)]
    else:  # those that these flights can tell
        separated, able = bool(np.min(np.asarray(signals["X"])) < SEPARATES), _able(state, signals)
        terms = library(signals, flights.aircraft, able, lateral=coefficient in LATERAL, separated=separated)

    def made(signals: Signals) -> Float[np.ndarray, "d n"]:
        return np.stack([term.evaluate(signals, flights.aircraft) for term in terms])

    deviation = np.std(state.residual / state.noise_growth, axis=0)
    series, slopes, scale = added.columns(coefficient, made, state.outputs, deviation)
    return [
        TermColumn(term, Component(coefficient, term.name, slopes[k, :, :, None] / size), size, float(series[k].std()))
        for k, (term, size) in enumerate(zip(terms, map(float, scale), strict=True))
        if np.isfinite(size) and size > 0.0
    ]


def polynomials(state: SelectionState, coefficient: str) -> list[Component]:
    """Polynomials of the angle of attack in one coefficient: themselves, and as factors of what else it depends on."""
    able, lateral = _able(state, state.responses.flights.channels), coefficient in LATERAL
    alpha, *others = (q for q in QUANTITIES if q is not THRUST and all(map(able, q.channels)))
    if alpha.name != "alpha":
        return []
    factors = {f"{q.name} times a polynomial of alpha": q for q in others if q.lateral == lateral}
    of = {name: [ProductTerm((alpha,) * k + (q,)) for k in range(DEGREES)] for name, q in factors.items()}
    of |= {} if lateral else {"a polynomial of alpha": [ProductTerm((alpha,) * k) for k in range(2, 2 + DEGREES)]}
    wanted = [t for terms in of.values() for t in terms]
    basis = {c.term.name: c.component.basis for c in columns_of(state, coefficient, wanted)}
    whole = [(x, [basis[t.name] for t in terms if t.name in basis]) for x, terms in reversed(of.items())]
    return [Component(coefficient, x, _apart(state, np.concatenate(parts, axis=2))) for x, parts in whole if parts]


def _apart(state: SelectionState, basis: Float[np.ndarray, "m c w"]) -> Float[np.ndarray, "m c v"]:
    """What the parameters that are in leave of powers, apart from one another, each of unit root mean square."""
    deviation = np.std(state.residual / state.noise_growth, axis=0)[:, None]
    inside = state.columns()
    S = state.S[:, :, inside[inside < len(state.theta)]]
    X, B = ((x / deviation)[:, np.any(basis != 0.0, axis=(0, 2))].reshape(-1, x.shape[2]) for x in (basis, S))
    B = B / np.maximum(np.sqrt(np.sum(B**2, axis=0)), 1e-300)
    U, size, _ = np.linalg.svd(X - B @ np.linalg.lstsq(B, X, rcond=1e-10)[0], full_matrices=False)
    U = U[:, size > 1e-6 * np.sqrt(np.sum(X**2, axis=0)).max()]
    apart = np.zeros((*basis.shape[:2], U.shape[1]))
    apart[:, np.any(basis != 0.0, axis=(0, 2))] = np.sqrt(len(U)) * U.reshape(len(basis), -1, U.shape[1])
    return apart * deviation / np.median(deviation)


def term_of(state: SelectionState, effect: str) -> TermColumn | None:
    """The term of one coefficient that an effect of one parameter is, by another name; None where it is none."""
    of_catalogue = next(e for e in state.full.model.effects if e.name == effect)
    acts_on = {name.removesuffix("_attached") for name in of_catalogue.example.increments}
    if len(of_catalogue.parameters) > 1 or len(acts_on) > 1 or not acts_on <= set(state.responses.model.coefficients):
        return None
    (coefficient,) = acts_on
    if not (columns := columns_of(state, coefficient)):
        return None
    x = np.concatenate([column.component.basis for column in columns], axis=2)
    reached = np.any(x != 0.0, axis=(0, 2))
    x, S = x[:, reached], state.S[:, reached][:, :, state.full.own_columns(effect)][:, :, 0]
    alike = np.einsum("mcj,mc->j", x, S) ** 2 / np.maximum(np.sum(x**2, axis=(0, 1)) * np.sum(S**2), 1e-300)
    return columns[int(np.argmax(alike))] if np.max(alike) > SAME else None


def imitated(state: SelectionState, effects: Sequence[str], components: Sequence[Component]) -> Float[np.ndarray, " j"]:
    """Share of what some additions make beside all else that each component of one coefficient makes, at most."""
    own, inside = state.full.own_columns(*effects), state.columns()
    if not (len(components) and len(own)):
        return np.zeros(len(components))
    beside = np.setdiff1d(inside[inside < len(state.theta)], own)
    reached = np.any(components[0].basis != 0.0, axis=(0, 2))
    A = np.concatenate([state.S[:, :, own], *(c.basis for c in components)], axis=2)[:, reached]
    weight = 1.0 / np.maximum(np.var(state.residual, axis=0)[reached], 1e-300)
    A = selection_state.partialled(A, state.S[:, reached][:, :, beside], weight) * np.sqrt(weight)[:, None]
    A, widths = A.reshape(-1, A.shape[2]), np.cumsum([len(own), *(c.basis.shape[2] for c in components)])
    X, *bases = np.split(A, widths[:-1], axis=1)
    size = np.maximum(np.sum(X**2, axis=0), 1e-300)
    made = [np.einsum("ik,ij,jk->k", B.T @ X, inverse(B.T @ B), B.T @ X) / size for B in bases]
    return np.max(made, axis=1)


def _able(state: SelectionState, signals: Signals) -> Callable[[str], bool]:
    flights = state.responses.flights
    noise = selection_state.noise_channels(flights)
    return lambda channel: channel in signals and channel not in noise and moves(signals[channel], flights, 1e-6)


@dataclass(frozen=True)
class FoundComponent:
    """A component that is taken for real, and the state in which it was found."""

    state: SelectionState
    component: Component
    share: float
    p_value: float


# --- Sinusoids in a coefficient, of own size and phase in each manoeuvre: fuel that sloshes, a control that hunts.

PERIOD = (0.6, 30.0)  # s, the shortest and the longest
FINER = 8  # frequencies between two of the scan, from which the best is taken
SCANNED = 2e7  # values of a sinusoid that memory holds at a time


def frequencies(state: SelectionState) -> Float[np.ndarray, " f"]:
    """Hz, half the resolution of the longest manoeuvre apart; of the lowest every manoeuvre shows a whole period."""
    seconds = np.bincount(state.responses.manoeuvre) * state.responses.seconds
    low, high = 1.0 / min(PERIOD[1], seconds.min()), 1.0 / max(PERIOD[0], 4.0 * state.responses.seconds)
    return np.arange(low, high, 0.5 / seconds.max()) if has_chunks(state) else np.zeros(0)


class WaveScan:
    """What sinusoids of these frequencies (Hz) in a coefficient explain beside all that is in a fit."""

    def __init__(self, state: SelectionState, fit: RegressionFit, coefficient: str, hertz: Float[np.ndarray, " f"]):
        self.state, self.coefficient, self.hertz = state, coefficient, hertz
        basis, manoeuvre, weight = self._basis(hertz), state.responses.manoeuvre, np.sqrt(1.0 / fit.variance)
        self.reached = np.any(basis != 0.0, axis=(0, 1, 3))
        self._weight, B = weight[self.reached], (state.scaled[:, :, fit.columns] * weight[:, None])[:, self.reached]
        basis = basis[:, :, self.reached] * (self._weight / state.noise_growth[:, self.reached])[:, :, None]
        self._rows = [np.flatnonzero((manoeuvre == k) & state.inside) for k in range(int(manoeuvre[-1]) + 1)]
        self._waves = [np.moveaxis(basis[:, rows], 0, 2) for rows in self._rows]  # m c f 2, of each manoeuvre
        self._B = [B[rows] for rows in self._rows]
        sums = [np.tensordot(b, x, ((0, 1), (0, 1))) for b, x in zip(self._B, self._waves, strict=True)]
        cross, count = np.concatenate(sums, axis=2), 2 * len(sums)  # k f 2M
        self._made = np.tensordot(inverse(fit.normal), cross, 1)
        information = -np.einsum("kfi,kfj->fij", cross, self._made, optimize=True)
        for k, x in enumerate(self._waves):
            at = slice(2 * k, 2 * k + 2)
            information[:, at, at] += np.einsum("mcfi,mcfj->fij", x, x, optimize=True)
        size = np.einsum("fii->f", information) / count
        self._bread = np.linalg.inv(information + 1e-9 * np.maximum(size, 1e-300)[:, None, None] * np.eye(count))

    def _basis(self, hertz: Float[np.ndarray, " f"]) -> Float[np.ndarray, "f m c 2"]:
        """Sine and cosine of each frequency as the residuals show them, of unit size."""

        def made(signals: Signals) -> Float[np.ndarray, "d n"]:
            phase = 2.0 * np.pi * np.outer(hertz, np.asarray(signals["elapsed"]))
            return np.concatenate([np.sin(phase), np.cos(phase)])

        state = self.state
        deviation = np.std(state.residual / state.noise_growth, axis=0)
        _, slopes, scale = state.added.columns(self.coefficient, made, state.outputs, deviation)
        shown = slopes / np.maximum(scale, 1e-300)[:, None, None]
        return np.moveaxis(shown.reshape(2, len(hertz), *shown.shape[1:]), 0, 3)

    def shares(self, residuals: Float[np.ndarray, "r m c"]) -> Float[np.ndarray, "r f"]:
        """Share of the variance of the outputs reached that each frequency takes away."""
        left = residuals[:, :, self.reached] * self._weight
        parts = [left[:, rows] for rows in self._rows]
        sums = [np.tensordot(x, wave, ((1, 2), (0, 1))) for x, wave in zip(parts, self._waves, strict=True)]
        beside = sum(np.tensordot(x, b, ((1, 2), (0, 1))) for x, b in zip(parts, self._B, strict=True))
        right = np.concatenate(sums, axis=2) - np.tensordot(beside, self._made, 1)
        gains = np.einsum("rfi,fij,rfj->rf", right, self._bread, right, optimize=True)
        return gains / np.maximum(sum(np.sum(x**2, axis=(1, 2)) for x in parts), 1e-300)[:, None]

    def component(self, hertz: float) -> Component:
        manoeuvre = self.state.responses.manoeuvre
        own = manoeuvre[:, None] == np.arange(int(manoeuvre[-1]) + 1)
        (wave,) = self._basis(np.array([hertz]))
        basis = np.concatenate([wave * here[:, None, None] for here in own.T], axis=2)
        return Component(self.coefficient, f"time, period {1.0 / hertz:.3g} s", basis, True)


def scans(state: SelectionState, fit: RegressionFit, coefficient: str) -> Iterator[WaveScan]:
    """Of all frequencies, as many at a time as memory allows."""
    hertz, size = frequencies(state), max(1, int(SCANNED / state.residual.size))
    for begin in range(0, len(hertz), size):
        yield WaveScan(state, fit, coefficient, hertz[begin : begin + size])


def waves(state: SelectionState, coefficients: Sequence[str]) -> list[Component]:
    """The sinusoid in each coefficient that explains most of what a state leaves."""
    hertz, residual, found = frequencies(state), state.left()[None], list[Component]()
    for name in coefficients if len(hertz) > 1 else ():
        shares = np.concatenate([scan.shares(residual)[0] for scan in scans(state, state.best, name)])
        best, step = hertz[np.argmax(shares)], hertz[1] - hertz[0]
        finer = WaveScan(state, state.best, name, np.linspace(max(best - step, hertz[0]), best + step, 2 * FINER + 1))
        found.append(finer.component(float(finer.hertz[np.argmax(finer.shares(residual))])))
    return found


def sought_waves(state: SelectionState, chosen: Sequence[Component], seed: int) -> Iterator[FoundComponent]:
    """Sinusoids beyond chance that predict parts of the manoeuvres left out, the largest share first."""
    alone, folds = len(state.responses.flights.lengths) == 1, chunks(state) if has_chunks(state) else ()
    whole = state.with_components((), chosen, folds) if folds else state
    trials = [Trial(state, wave, chosen, folds) for wave in waves(whole, state.outputs)]
    least = state.settings.single_share if alone else state.settings.periodic_share
    for trial in sorted(trials, key=lambda trial: -trial.share):
        if trial.share >= least and trial.gain > 0.0:
            colour = screening.autocorrelation_of(trial.state.left(trial.fit), folds)
            # As in `screening.null_shares`.
            held, rng = whole.fit(held=trial.fit.variance), np.random.default_rng(seed)
            white = screening.white_noise(state.settings.unnamed_replicates, folds, len(state.outputs), rng)
            noises = screening.noise_records(whole, held, colour, white)
            every = (scan for name in state.outputs for scan in scans(whole, held, name))
            p = screening.chance_of(trial.share, np.max([scan.shares(noises).max(axis=1) for scan in every], axis=0))
            if p <= state.settings.unnamed_false_alarm_rate:
                yield FoundComponent(state, trial.state.components[0], trial.share, p)


# --- A parameter of the model that takes another value during the records: is there one beyond chance, and where.
# The largest gain over all parameters and moments is compared with that in noise-only replicates, which make the same
# choice. Then the change must explain enough and predict parts of the manoeuvres that it was not fitted to.


@dataclass(frozen=True)
class FoundChange(FoundComponent):
    """A change of a parameter that is beyond chance, with what it was judged by."""

    at: tuple[int, int]  # its place in the scan (span, parameter)
    unit: float  # what a step of one is of the component
    scan: ChangeScan
    residual: Rows
    colour: screening.Autocorrelation
    gain: float  # deviance that it takes away
    gained: float  # deviance of the parts left out


def sought_change(
    state: SelectionState, chosen: Sequence[Component], *, seed: int, least: float = 0.0
) -> FoundChange | None:
    """The change that explains most beside the `chosen` components, if it predicts left-out parts beyond `least`."""
    settings, alone = state.settings, len(state.responses.flights.lengths) == 1
    first = _promising(state, chosen, least) if testable(state) else None
    if first is None:
        return None
    # All active parameters at their optimum with it beside them.
    wide, folds = state.with_components((), [*chosen, first[0]]), manoeuvres(state.responses.manoeuvre)
    state = selection_state.moved(state, selection_state.optimum(wide, range(len(state.folds))))
    whole, wider = state.with_components((), chosen, folds), Trial(state, first[0], chosen, folds).fit
    # Under the variances that it leaves: what it explains itself would pass for noise of its coefficient.
    held = whole.fit(held=wider.variance)
    scan, residual = ChangeScan(whole, held, first[1].columns, first[1].over, first[1].noise), whole.left(held)
    at, _, _ = scan.leader(residual)
    component, unit = scan.component(state, at)
    trial, gained = Trial(state, component, chosen, folds), holdout_gain_of(state, component, chosen)
    enough = trial.share >= (settings.single_share if alone else settings.change_share) and gained > least
    if not enough or _by_noise(trial, scan, at, unit):
        return None
    # What was chosen as the best of many makes the noise look faster than it is; replicates measure by how much.
    noise = screening.SharedNoise(seed, folds, len(state.outputs), settings)
    colour = screening.autocorrelation_of(trial.state.left(trial.fit), folds)
    again = [scan.without_leader(x) for x in screening.noise_records(whole, held, colour, noise.correction)]
    colour = screening.unbiased(colour, screening.autocorrelations_of(np.array(again), folds))
    nulls = [scan.statistic(x) for x in screening.noise_records(whole, held, colour, noise.replicates)]
    p = screening.chance_of(scan.statistic(residual), np.array(nulls))
    if p > settings.change_false_alarm_rate:
        return None
    gain = whole.best.deviance - trial.fit.deviance
    return FoundChange(state, component, trial.share, p, at, unit, scan, residual, colour, gain, gained)


def testable(state: SelectionState) -> bool:
    """Whether the state is of coefficients that are modelled, and every manoeuvre long enough to be divided."""
    long = all(part.stop - part.start > ORDER for part in parts_of(state, state.settings.change_parts))
    return state.of_coefficients and long and all(map(len, _scanned(state)))


def _scanned(state: SelectionState) -> tuple[Columns, list[Span]]:
    """Columns of the parameters of the aerodynamics that are in, and the times at which they may change."""
    acting = [e for e in state.full.model.effects if e.kind is Kind.AERODYNAMICS and e.stage > Stage.INFLOW]
    parameters, names = {p for e in acting for p in state.full.parameters_of(e.name)}, state.full.model.names
    columns = np.array([c for c in state.columns() if c < len(names) and names[c] in parameters], int)
    least = max(1, round(state.settings.change_least / state.responses.seconds))
    return columns, spans(state.responses.manoeuvre, least, state.settings.change_begins)


def _promising(state: SelectionState, chosen: Sequence[Component], least: float) -> tuple[Component, ChangeScan] | None:
    """The change that explains most to first order, if that is worth another look."""
    whole, (columns, over) = state.with_components((), chosen, manoeuvres(state.responses.manoeuvre)), _scanned(state)
    # What noise of the recorded size adds to the sensitivities, scaled as those are. Added once more it adds as much as
    # the noise that is there already, as in `selection.noise_effect`.
    flights, rng, fit = state.responses.flights, np.random.default_rng(0), whole.best
    added = {n: sd * rng.standard_normal(flights.n) for n, sd in flights.noise.items()}
    noisy = flights.channels | {name: flights.channels[name] + x for name, x in added.items()}
    slopes = state.responses.with_channels(noisy).linearise(state.theta, columns)[1][:, state.kept_outputs]
    scan = ChangeScan(whole, fit, columns, over, slopes / state.noise_growth[:, :, None] - state.scaled[:, :, columns])
    at, gain, _ = scan.leader(whole.left())
    if gain < state.settings.least_share * len(state.residual):
        return None
    component, _ = scan.component(state, at)
    return (component, scan) if holdout_gain_of(state, component, chosen) > least else None


def _by_noise(trial: Trial, scan: ChangeScan, place: tuple[int, int], unit: float) -> bool:
    """Whether one value, made too small by noise on either side of the change, explains it."""
    # To first order a share s of noise takes s of a value away; what lies between a value and that with twice as much
    # given back may be its truth.
    column = int(scan.columns[place[1]])
    (at,) = trial.fit.places([column])
    elsewhere = float(trial.state.theta[column] + trial.fit.step[at])
    values = elsewhere + unit * float(trial.fit.step[-1]), elsewhere
    shares = scan.noise_shares[:, place[0], place[1]]
    pairs = zip(values, shares, strict=True)
    least, most = np.sort([np.array([x, x / max(1.0 - 2.0 * s, 1e-300)]) for x, s in pairs]).T
    return bool(np.max(least) <= np.min(most))


def holdout_gain_of(state: SelectionState, component: Component, chosen: Sequence[Component]) -> float:
    """Deviance that a component gains on parts of the manoeuvres that were left out, each predicted from the others."""
    return Trial(state, component, chosen, parts_of(state, state.settings.change_parts)).gain


# --- Every moment at which a parameter may take another value, all parameters at once, from cumulated products.
# The direction of a change is the parameter's sensitivity from that moment on, the free parameters of the model
# projected out. Inner products of such directions are differences of sums over time, so a record of minutes costs
# milliseconds. What a parameter acts through is recorded with noise, which makes its value too small: where a slope is
# attenuated by noise alone, the parameter has not changed.

NOTHING = 1e-9  # of the information of the whole parameter, below which a change of it moves nothing
NOISY = 0.5  # share of noise beyond which a value is that of noise


class Span(NamedTuple):
    """Blocks over which a parameter has another value, [begin, end); `manoeuvre` is the number of that of the first."""

    manoeuvre: int
    begin: int
    end: int


def spans(manoeuvre: Int[np.ndarray, " m"], least: int, most: int) -> list[Span]:
    """From a block on, to the end of its manoeuvre or of all later ones; `least` blocks at either end are undivided."""
    count, m = int(manoeuvre[-1]) + 1, len(manoeuvre)
    changes = []
    for k in range(count):
        blocks = np.flatnonzero(manoeuvre == k)
        first, last = int(blocks[0]), int(blocks[-1]) + 1
        begins = [*([first] if k else []), *range(first + least, last - least + 1, -(-m // most))]
        # The records may be of one flight, where a change lasts, or of several, where it does not.
        ends = {m} if k == count - 1 else {last, m}
        changes += [Span(k, begin, end) for begin in begins for end in sorted(ends)]
    return changes


class ChangeScan:
    """Directions of the changes of p parameters over each of n spans; recording noise adds `noise` to sensitivities."""

    def __init__(
        self,
        state: SelectionState,
        fit: RegressionFit,
        columns: Int[np.ndarray, " p"],
        over: Sequence[Span],
        noise: Float[np.ndarray, "m c p"],
    ) -> None:
        self.columns, self.over, self.noise, self.weight = columns, over, noise, 1.0 / fit.variance
        self._S, self._B = state.scaled[:, :, columns], state.scaled[:, :, fit.columns]
        self._begin, self._end = (np.array([getattr(span, side) for span in over]) for side in ("begin", "end"))
        self._weighed = self._S * self.weight[:, None]
        squares = self._summed(np.sum(self._S * self._weighed, axis=1))
        cross = self._summed(np.matmul(np.moveaxis(self._weighed, 1, 2), self._B))
        self._shares = cross @ inverse(fit.normal)  # n p k
        information = squares - np.sum(self._shares * cross, axis=2)
        self.noise_shares = self._noise_shares(fit, squares, cross)
        whole, noisy = np.sum(self._S * self._weighed, axis=(0, 1)), np.any(self.noise_shares > NOISY, axis=0)
        self._idle = noisy | (information <= NOTHING * whole)  # what the model can do as well
        self.information = np.where(self._idle, 1.0, information)

    def _noise_shares(self, fit: RegressionFit, squares: np.ndarray, cross: np.ndarray) -> np.ndarray:
        """Share of noise in what tells the value of each parameter within each span, and in what tells it elsewhere."""

        def form(x: Float[np.ndarray, "n k"], y: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " n"]:
            return np.sum((x @ others) * y, axis=1)

        added = np.einsum("mcp,c->mp", self.noise**2, self.weight)
        within = self._summed(added)
        noise = np.stack([within, np.sum(added, axis=0) - within])
        # By it least squares makes that value too small. All other parameters have one value, fitted beside both.
        whole = np.sum(self._S * self._weighed, axis=(0, 1))
        shared, shares = inverse(fit.normal), np.zeros_like(noise)
        for p, column in enumerate(self.columns):
            (at,) = fit.places([column])
            others = shared - np.outer(shared[:, at], shared[at]) / shared[at, at]  # without the parameter itself
            total = np.einsum("mc,mck->k", self._weighed[:, :, p], self._B)
            inside, outside = cross[:, p], total - cross[:, p]
            a, b = squares[:, p] - form(inside, inside), whole[p] - squares[:, p] - form(outside, outside)
            c = -form(inside, outside)
            information = np.stack([a - c**2 / np.maximum(b, 1e-300), b - c**2 / np.maximum(a, 1e-300)])
            shares[:, :, p] = noise[:, :, p] / np.maximum(information, 1e-300)
        return shares

    def _summed(self, x: Float[np.ndarray, "m ..."]) -> Float[np.ndarray, "n ..."]:
        total = np.concatenate([np.zeros((1, *x.shape[1:])), np.cumsum(x, axis=0)])
        return total[self._end] - total[self._begin]

    def estimates(self, residual: Float[np.ndarray, "m c"]) -> Float[np.ndarray, "n p"]:
        """First-order estimate of each change; zero where it moves nothing that the model cannot."""
        weighed = residual * self.weight
        beside = self._shares @ np.einsum("mck,mc->k", self._B, weighed)
        right = self._summed(np.einsum("mcp,mc->mp", self._S, weighed)) - beside
        return np.where(self._idle, 0.0, right / self.information)

    def gains(self, estimates: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n p"]:
        return estimates**2 * self.information

    def leader(self, residual: Rows) -> tuple[tuple[int, int], float, float]:
        """The change that explains most of a residual: its place, the deviance that it takes away, its estimate."""
        estimates = self.estimates(residual)
        gains = self.gains(estimates)
        span, parameter = np.unravel_index(int(np.argmax(gains)), gains.shape)
        at = int(span), int(parameter)
        return at, float(gains[at]), float(estimates[at])

    def without_leader(self, residual: Rows) -> Rows:
        at, _, estimate = self.leader(residual)
        return residual - self.explained(*at, estimate)

    def statistic(self, residual: Rows) -> float:
        gain = self.leader(residual)[1]
        return gain / (float(np.sum(residual**2 * self.weight)) - gain)

    def component(self, state: SelectionState, at: tuple[int, int]) -> tuple[Component, float]:
        """What a change adds, about as large as the residuals, and its size."""
        span, column = self.over[at[0]], int(self.columns[at[1]])
        basis = np.zeros((*state.residual.shape, 1))
        basis[span.begin : span.end, :, 0] = state.S[span.begin : span.end, :, column]
        unit = 1.0 / float(np.sqrt(np.max(np.mean(basis**2, axis=0))))
        return Component(state.full.model.names[column], f"blocks from {span.begin}", unit * basis), unit

    def explained(self, span: int, parameter: int, estimate: float) -> Float[np.ndarray, "m c"]:
        """What a change of this size takes away of the residual, scaled as that is."""
        explained = -self._B @ self._shares[span, parameter]
        here = slice(self._begin[span], self._end[span])
        explained[here] += self._S[here, :, parameter]
        return estimate * explained


# --- What is reported of a change: the parameter before and after, when, and what else explains as much.

NEAREST = 200  # moments that are compared with the best one, those that explain most


def reported_change(
    state: SelectionState, change: FoundChange, chosen: Sequence[Component], election: screening.ScreeningResult | None
) -> ParameterChange:
    """A change with its sizes beside all that is in the state and `chosen`; `election` is that which added nothing."""
    span, column = change.scan.over[change.at[0]], int(change.scan.columns[change.at[1]])
    begin, parameter = int(np.argmax(state.responses.manoeuvre == span.manoeuvre)), state.full.model.free[column]
    sizes = dict(zip(("before", "after", "size"), _sizes(state, change, chosen, column), strict=True))
    nearest, rivals, inflation = _as_good(state, change)
    seconds, scores = state.responses.seconds, [] if election is None else election.candidate_scores
    effects = [s.effect for s in scores if nats(change.gain - s.gain, inflation) < state.settings.ambiguous]
    return ParameterChange(
        parameter=parameter.name,
        unit=parameter.unit,
        manoeuvre=state.responses.flights.names[span.manoeuvre],
        at=(span.begin - begin) * seconds,  # a block is as fine as it gets
        interval=(max(nearest[0] - 1 - begin, 0) * seconds, (nearest[1] + 1 - begin) * seconds),
        lasts=span.end == len(state.residual),
        **sizes,
        share=change.share,
        p_value=change.p_value,
        gain=nats(change.gained, inflation),
        ambiguous_with=tuple(dict.fromkeys([*rivals, *effects])),
    )


def _sizes(state: SelectionState, change: FoundChange, chosen: Sequence[Component], column: int) -> list[tuple]:
    """Value before, after, and their difference, with standard errors; all that is in is fitted beside."""
    whole = state.with_components((), chosen, manoeuvres(state.responses.manoeuvre))
    fit, widths = whole.best, [c.basis.shape[2] for c in chosen]
    place = len(fit.columns) - sum(widths) + sum(widths[: [c is change.component for c in chosen].index(True)])
    (at,), combinations = fit.places([column]), np.zeros((3, len(fit.columns)))
    combinations[[0, 1], at], combinations[[1, 2], place] = 1.0, change.unit
    variance = np.einsum("ai,ij,aj->a", combinations, screening.uncertainty(whole), combinations)
    values = combinations @ fit.step + state.theta[column] * np.array([1.0, 1.0, 0.0])
    return [(float(x), float(sd)) for x, sd in zip(values, np.sqrt(np.maximum(variance, 0.0)), strict=True)]


def _as_good(state: SelectionState, change: FoundChange) -> tuple[tuple[int, int], list[str], float]:
    """First and last block where it may begin as well; other parameters that explain as much; variance inflation."""
    scan, settings, (span, parameter) = change.scan, state.settings, change.at
    estimates = scan.estimates(change.residual)
    gains, chosen = scan.gains(estimates), scan.over[span]
    same = [i for i, other in enumerate(scan.over) if (other.manoeuvre, other.end) == (chosen.manoeuvre, chosen.end)]
    same = sorted(same, key=lambda i: -gains[i, parameter])[:NEAREST]
    others = [(int(best), p) for p, best in enumerate(np.argmax(gains, axis=0)) if p != parameter]
    places = [(span, parameter), *((i, parameter) for i in same), *others]
    # Two changes are told from each other by the residual along the difference of what they explain.
    apart = np.stack([scan.explained(*place, float(estimates[place])) for place in places], axis=2)
    apart[:, :, 1:] = apart[:, :, :1] - apart[:, :, 1:]
    inflation = screening.inflation_along(apart, scan.weight, manoeuvres(state.responses.manoeuvre), change.colour)
    lost = [nats(float(gains[span, parameter] - gains[p]), float(x)) for p, x in zip(places, inflation, strict=True)]
    times = [scan.over[i].begin for i, x in zip(same, lost[1:], strict=False) if x <= settings.change_interval]
    names = [state.full.model.names[scan.columns[p]] for _, p in others]
    rivals = sorted((x, name) for x, name in zip(lost[1 + len(same) :], names, strict=True) if x < settings.ambiguous)
    return (min(times), max(times)), [name for _, name in rivals], float(inflation[0])
