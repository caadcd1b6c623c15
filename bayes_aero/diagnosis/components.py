"""Functions that are candidates in place of effects: smooth ones of channels, periods, terms of the library."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Float

from bayes_aero.diagnosis.accuracy import holdout_deviance_gain
from bayes_aero.diagnosis.candidate_set import moves, noise_channels
from bayes_aero.diagnosis.result import ProductTerm, TermFactor
from bayes_aero.diagnosis.screening import autocorrelation_of, chance_of, null_shares
from bayes_aero.diagnosis.selection_state import Component, RegressionFit, SelectionState, manoeuvre_constants
from bayes_aero.flight.health import noise_of
from bayes_aero.inference.covariance import ORDER
from bayes_aero.physics.aircraft import LATERAL, Aircraft
from bayes_aero.physics.kinematics import reduced, reduced_lateral
from bayes_aero.residuals.base import Signals

# --- Terms that nobody listed: products, breaks, bumps, what acts in separated flow alone, memory.
# A term is a product of factors. A factor is a nondimensional quantity of the flight, a function of the angle of
# attack, the separated share 1 - X, or a quantity as it was some chords ago.

MOST_FACTORS = 3  # most factors of a product
BREAKS = tuple(k / 20.0 for k in range(1, 20))  # quantiles of alpha or beta at which its effect may break
BUMPS = tuple(k / 10.0 for k in range(1, 10))  # and at which it may have a bump
WIDTHS = (0.07, 0.12, 0.2)  # of a bump, shares of the range
CLEAR = 3.0  # standard deviations of its noise; nearer to zero, noise decides the sign and makes a dead band
LAGS = (5.0, 15.0, 40.0)  # chords travelled, time constants of memory


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
    own, lateral = quantity.code, quantity.lateral
    code = f"xp.maximum({f'xp.abs({own})' if lateral else own} - {at!r}, 0.0)"
    name = f"max({_beyond(quantity, at)}, 0)"
    if lateral:
        name, code = f"sign({quantity.name}) max(|{quantity.name}| - {at:g}, 0)", f"xp.sign({own}) * {code}"

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

PERIODS = tuple(np.round(np.geomspace(0.6, 30.0, 48), 3))  # s
ODD = ("beta", "p", "r", "aileron", "rudder")
SKIPPED = ("ax", "ay", "az", "p_dot", "q_dot", "r_dot", "alpha_dot")  # responses themselves, not causes
SEPARATES = 0.9  # X below which a flight tells what acts in separated flow alone; our choice
DEGREES = 4  # columns of a polynomial of the angle of attack; our choice
SAME = 0.999  # squared cosine of what an effect and a term do to a coefficient, beyond which they are one; our choice
BYTES = 2e9  # of memory that inner products may take


def families(state: SelectionState) -> tuple[tuple[Sequence[slice], list[Component], float], ...]:
    """Kinds of components that the record can test: folds by which they must predict, themselves, least share."""
    s, alone = state.settings, len(state.responses.flights.lengths) == 1
    channel, wave = (s.single_share, s.single_share) if alone else (s.unnamed_share, s.periodic_share)
    periodic = [(chunks(state), periodic_components(state), wave)] if has_chunks(state) else []
    terms = [column.component for name in state.outputs for column in columns_of(state, name)]
    return (state.folds, smooth_components(state), channel), *periodic, (state.folds, terms, channel)


def smooth_components(state: SelectionState) -> list[Component]:
    """A smooth function, in each coefficient, of every recorded channel that moves and is more than white noise."""
    signals, flights, knots = state.responses.predict(state.theta), state.responses.flights, state.settings.knots
    skipped = (*SKIPPED, *noise_channels(flights))
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


def periodic_components(state: SelectionState) -> list[Component]:
    """A sinusoid of each period and free phase in each manoeuvre, in each coefficient."""
    elapsed = np.asarray(state.responses.block(state.responses.flights.channels["elapsed"]))
    manoeuvre, seconds, components = state.responses.manoeuvre, state.responses.seconds, []
    longest = np.bincount(manoeuvre).min() * seconds  # of which every manoeuvre shows a whole one
    for period in (period for period in PERIODS if 4.0 * seconds <= period <= longest):
        phase = 2.0 * np.pi * elapsed / period
        wave = np.stack([np.sin(phase), np.cos(phase)], axis=1)
        basis = np.concatenate([wave * (manoeuvre == k)[:, None] for k in range(int(manoeuvre[-1]) + 1)], axis=1)
        columns = dict.fromkeys(state.outputs, basis)
        components += _in_each(state, f"time, period {period:.3g} s", columns, periodic=True)
    return components


def _in_each(
    state: SelectionState, channel: str, columns: dict[str, Float[np.ndarray, "m w"]], *, periodic: bool = False
) -> list[Component]:
    components = []
    for coefficient, column in columns.items():
        basis = np.zeros((len(column), len(state.outputs), column.shape[1]))
        basis[:, state.outputs.index(coefficient)] = column
        components.append(Component(coefficient, channel, basis, periodic))
    return components


def offsets_left(state: SelectionState, *, seed: int) -> tuple[str, ...]:
    """Coefficients whose mean residual differs between manoeuvres beyond chance, as that of a function must."""
    left = [c for c in state.outputs if c not in state.apart]
    if len(state.responses.flights.lengths) == 1 or not left or not has_chunks(state):
        return ()
    folds, constants = chunks(state), manoeuvre_constants
    manoeuvre = state.responses.manoeuvre
    components = [Component(c, "manoeuvre", constants(manoeuvre, state.outputs, c)[:, :, 1:]) for c in left]
    whole, differing = state.with_components(components, (), folds), []
    for component in components:
        trial = Trial(state, component, (), folds)
        enough = trial.share >= state.settings.unnamed_share and trial.gain > 0.0
        if enough and trial.chance([whole], seed) <= state.settings.unnamed_false_alarm_rate:
            differing.append(component.coefficient)
    return tuple(differing)


# --- The folds by which components must predict.


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


# --- Components in a regression.


def in_batches(state: SelectionState, components: Sequence[Component], folds: Sequence[slice]) -> list[list[Component]]:
    """The components in as few sets as memory allows: inner products of all columns grow with their number squared."""
    each = 8.0 * len(folds) * state.residual.shape[1]  # bytes of one pair of columns
    most = max(int(np.sqrt(BYTES / each)) - state.S.shape[2], 1)
    batches: list[list[Component]] = [[]]
    width = 0
    for component in components:
        wide = component.basis.shape[2]
        if batches[-1] and width + wide > most:
            batches.append([])
            width = 0
        batches[-1].append(component)
        width += wide
    return batches


class Trial:
    """A component as the only candidate beside those `chosen`, and the fit with it in."""

    def __init__(
        self,
        state: SelectionState,
        component: Component,
        chosen: Sequence[Component] = (),
        folds: Sequence[slice] | None = None,
    ) -> None:
        self.state = state.with_components((component,), chosen, folds)
        self.wide = self.state.wider(self.state.component_columns[0])

    @cached_property
    def fit(self) -> RegressionFit:
        return self.state.fit_columns(self.wide)

    @cached_property
    def share(self) -> float:
        """Share of a coefficient's remaining variance that it takes away, at best over the coefficients."""
        return float(np.max(1.0 - self.fit.variance / self.state.fit().variance))

    @cached_property
    def gain(self) -> float:
        return holdout_deviance_gain(self.state, self.wide)

    def chance(self, among: Sequence[SelectionState], seed: int) -> float:
        """How often noise of the colour that is left alone lets some component of these explain as large a share."""
        colour = autocorrelation_of(self.state.left(self.fit), self.state.folds)
        nulls = [null_shares(state, colour, self.fit.variance, seed) for state in among]
        return chance_of(self.share, np.max(nulls, axis=0))


# --- The library's terms, and polynomials, as columns of a regression.


@dataclass(frozen=True)
class TermColumn:
    """A term of one coefficient as these flights show it."""

    term: ProductTerm
    component: Component  # what `scale` times the term adds to the residuals, about as large as these
    scale: float
    spread: float  # the term's own deviation


def columns_of(state: SelectionState, coefficient: str, given: Sequence[ProductTerm] = ()) -> list[TermColumn]:
    """The library's terms in one coefficient, or those `given`, as the residuals show them to first order."""
    added, flights = state.responses.added(state.theta), state.responses.flights
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
    factors = [q for q in others if q.lateral == lateral]
    of = {
        f"{q.name} times a polynomial of alpha": [ProductTerm((alpha,) * k + (q,)) for k in range(DEGREES)]
        for q in factors
    }
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
    columns = columns_of(state, coefficient)
    alike = [likeness(state, [effect], column) for column in columns]
    return columns[int(np.argmax(alike))] if max(alike, default=0.0) > SAME else None


def likeness(state: SelectionState, effects: Sequence[str], column: TermColumn) -> float:
    """Largest squared cosine of what parameters of effects and a term do to the outputs that the term reaches."""
    x = column.component.basis[:, :, 0]
    reached = np.any(x != 0.0, axis=0)
    x, S = x[:, reached], state.S[:, reached][:, :, state.full.own_columns(*effects)]
    alike = np.einsum("mc,mck->k", x, S) ** 2 / np.maximum(np.sum(x**2) * np.sum(S**2, axis=(0, 1)), 1e-300)
    return float(np.max(alike, initial=0.0))


def _able(state: SelectionState, signals: Signals) -> Callable[[str], bool]:
    flights = state.responses.flights
    noise = noise_channels(flights)
    return lambda channel: channel in signals and channel not in noise and moves(signals[channel], flights, 1e-6)
