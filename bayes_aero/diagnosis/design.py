"""Which manoeuvre would tell an ambiguity set apart: standard inputs flown in the simulator, and what they would say.

Each manoeuvre is flown from the present parameters without noise. On its record every effect of the set has a
sensitivity; the active parameters are projected out of it, as in an election. Two effects are told apart by what one
does that the best imitation by the other, and by the active parameters, cannot follow. The noise is that which the
present model leaves, with its colour. Source of the idea: Klein and Morelli, *Aircraft System Identification*, 2006,
ch. 9 (design of inputs from the information matrix).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from bayes_aero.diagnosis.screening.autocorrelation import Autocorrelation, autocorrelation_of
from bayes_aero.diagnosis.screening.regression import inverse
from bayes_aero.diagnosis.screening.selection_state import SelectionState, linearised
from bayes_aero.diagnosis.settings import ENOUGH
from bayes_aero.dynamics.simulated.manoeuvres import EXCITED_CHANNELS, fly_standard
from bayes_aero.dynamics.simulated.rigid_manoeuvres import LATERAL_EXCITED_CHANNELS, fly_rigid_standard
from bayes_aero.effect import Effect, Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.axes import Axis
from bayes_aero.model.joined_channels import Flights
from bayes_aero.model.joined_records import Recorded
from bayes_aero.model.model import Model
from bayes_aero.model.observations import marks
from bayes_aero.physics.atmosphere import altitude_of_density
from bayes_aero.residuals.equation_error import EquationError

NOT_BY_HAND = ("multisine",)  # a manoeuvre that needs a computer at the controls is not proposed
BEGINNING = 2.0  # s of the record whose means are the flight condition
Pair = tuple[str, str]


@dataclass(frozen=True)
class Separation:
    """What one manoeuvre says of a set.

    `correlation` of each pair's sensitivities, active parameters projected out. `deviations`, for each ordered pair
    (one, other): by how many standard deviations the first, at the least size worth modelling, differs from its best
    imitation by the other. `weakest` is the smallest of them.
    """

    manoeuvre: str
    correlation: Mapping[Pair, float]
    deviations: Mapping[Pair, float]

    @property
    def weakest(self) -> float:
        """Deviations by which the closest pair differs."""
        return min(self.deviations.values())


@dataclass(frozen=True)
class Design:
    """Every manoeuvre that could be flown, the most telling first; `refused` says why the others could not.

    `status` names the manoeuvre that would separate the set, or says that none of the list would.
    """

    effects: tuple[str, ...]
    manoeuvres: tuple[Separation, ...]
    refused: Mapping[str, str]
    status: str

    @property
    def best(self) -> str | None:
        """The most telling manoeuvre, if it tells enough."""
        first = self.manoeuvres[0] if self.manoeuvres else None
        return first.manoeuvre if first is not None and first.weakest >= ENOUGH else None


@dataclass(frozen=True)
class _Noise:
    """Residuals of the present model: variance and colour by output, growth of each with 1 - X."""

    outputs: tuple[str, ...]
    variance: Float[np.ndarray, " c"]
    colour: Autocorrelation
    growth: Float[np.ndarray, " c"]

    def of(self, outputs: Sequence[str]) -> _Noise:
        """Of those outputs alone that are among `outputs`."""
        at = [c for c, name in enumerate(self.outputs) if name in outputs]
        colour = Autocorrelation(self.colour.phi[at], self.colour.sigma[at])
        return _Noise(tuple(self.outputs[c] for c in at), self.variance[at], colour, self.growth[at])


@dataclass(frozen=True)
class Standard:
    """The standard manoeuvres as a state's model flies them.

    `theta` are the values flown; `refused` says which manoeuvre could not be flown, and why.
    """

    model: Model
    theta: Mapping[str, float]
    flown: Mapping[str, Flights]
    refused: Mapping[str, str]


def standard(state: SelectionState, effects: Sequence[str], *, amplitude: float = 1.0) -> Standard:
    """Fly the standard manoeuvres with the effects that are in, and with those of `effects` that are candidates.

    A model of both axes flies them in six degrees of freedom, and those of the lateral axis too.

    `amplitude` multiplies every input. What the record itself gets wrong (sensors, thrust) is flown as at neutral.
    """
    rigid = Axis.LATERAL in state.full.model.axes
    if rigid and Axis.LONGITUDINAL not in state.full.model.axes:
        raise InputError(
            "manoeuvres that would separate them are flown from level flight, for which the card has no lift and drag; "
            'add "longitudinal" to [model] axes'
        )
    small = _narrowed(state, effects)
    true = state.full.at_neutral(state.theta, [e.name for e in small.effects if e.stage is Stage.CHANNEL])
    theta = {n: x for n, x in zip(state.full.model.names, true, strict=True) if n in small.names}
    values, flights = dict(small.fixed) | theta, state.responses.flights
    begin = round(BEGINNING * 5 / state.responses.seconds)
    start = _start({name: float(np.mean(np.asarray(x)[:begin])) for name, x in flights.channels.items()})
    dt = float(np.median(np.asarray(flights.channels["dt"])))
    aircraft = small.actual_aircraft(values, flights.aircraft)
    moved = EXCITED_CHANNELS | (LATERAL_EXCITED_CHANNELS if rigid else {})
    flown, refused = (fly_rigid_standard if rigid else fly_standard)(
        small, values, aircraft, **start, dt=dt, amplitude=amplitude
    )
    flown = {name: channels for name, channels in flown.items() if name not in NOT_BY_HAND}
    unseen = {name: moved[name] for name in flown if name in moved and moved[name] not in flights.recorded}
    refused |= {name: f"{channel} was not recorded" for name, channel in unseen.items()}
    recorded = {name: _recorded(flights, channels, dt) for name, channels in flown.items() if name not in unseen}
    return Standard(small, theta, recorded, refused)


def _start(mean: Mapping[str, float]) -> dict[str, float]:
    """Airspeed, m/s, and altitude, m: where none was recorded, that of standard air of the record's density."""
    altitude = mean["altitude"] if "altitude" in mean else altitude_of_density(mean["density"])
    return {"airspeed": mean["airspeed"], "altitude": altitude}


def separating(
    state: SelectionState,
    effects: Sequence[str],
    *,
    amplitude: float = 1.0,
    sizes: Mapping[str, float] | None = None,
    flights: Standard | None = None,
) -> Design:
    """Rank the standard manoeuvres by how well each tells `effects` apart.

    `effects` are candidates of the state, in or not; `sizes` replaces parameters' least sizes worth modelling.
    `flights` are the manoeuvres, if they were flown for this set and others (default: flown here with `amplitude`).
    """
    chosen = [_candidate(state, name) for name in dict.fromkeys(effects)]
    if len(chosen) < 2:
        raise InputError("an ambiguity set has at least two effects")
    names = tuple(e.name for e in chosen)
    if flights is None:
        flights = standard(state, names, amplitude=amplitude)
    noise = _noise(state)
    worth = {p: least for e in chosen for p, (least, _) in e.sizes.items()} | dict(sizes or {})
    found = [
        _judged(name, _on_record(state, flights.model, record, flights.theta, chosen, noise), chosen, worth)
        for name, record in flights.flown.items()
    ]
    found.sort(key=lambda s: -s.weakest)
    return Design(names, tuple(found), flights.refused, _words(names, found))


def _words(names: Sequence[str], found: Sequence[Separation]) -> str:
    listed = ", ".join(names)
    if not found:
        return f"none of the standard manoeuvres can be simulated from this state, so there is no answer for {listed}"
    best, called = found[0], found[0].manoeuvre.replace("_", " ")
    if best.weakest >= ENOUGH:
        return f"{called} would separate {listed}: they differ by {best.weakest:.1f} standard deviations"
    return f"no standard manoeuvre separates {listed}; the best, {called}, gives {best.weakest:.1f} deviations"


def _candidate(state: SelectionState, name: str) -> Effect:
    found = next((e for e in state.full.model.effects if e.name == name and e.parameters), None)
    if found is None:
        raise InputError(f"effect {name} is none that this record can test; choose among the candidates of the state")
    return found


def _narrowed(state: SelectionState, chosen: Sequence[str]) -> Model:
    """The card's effects, those that are in, those chosen, and those without parameters: less to compile."""
    kept = {*state.full.base, *state.active, *chosen}
    effects = tuple(e for e in state.full.model.effects if e.name in kept or not e.parameters)
    names = {p.name for e in effects for p in e.parameters}
    fixed = tuple((k, x) for k, x in state.full.model.fixed if k in names)
    own = tuple(p for p in state.full.model.parameters if p.name in names)
    return replace(state.full.model, effects=effects, parameters=own, fixed=fixed)


def _noise(state: SelectionState) -> _Noise:
    """Residuals of the coefficients and, where it was recorded, of the flight path at the present parameters."""
    residual, known = state.responses.evaluate(jnp.asarray(state.theta))
    residual, manoeuvre = np.array(residual), state.responses.manoeuvre
    apart = 1.0 - np.asarray(state.responses.block(known["X"]))
    growth = np.zeros(residual.shape[1])
    for c, name in enumerate(state.responses.outputs):
        if name in state.outputs and np.any(apart > 0.0):
            own = state.noise_growth[:, state.outputs.index(name)]
            growth[c] = max(0.0, float((own - 1.0) @ apart / (apart @ apart)))
        if name not in state.full.model.coefficients:
            for k in range(int(manoeuvre[-1]) + 1):
                residual[manoeuvre == k, c] -= residual[manoeuvre == k, c].mean()
    residual /= 1.0 + growth * apart[:, None]
    folds = [slice(int(e[0]), int(e[-1]) + 1) for e in (np.flatnonzero(manoeuvre == k) for k in np.unique(manoeuvre))]
    return _Noise(state.responses.outputs, np.mean(residual**2, axis=0), autocorrelation_of(residual, folds), growth)


def _recorded(like: Recorded, channels: Mapping[str, np.ndarray], dt: float) -> Flights:
    """One manoeuvre with the channels of a record; a channel that the simulator does not make keeps its mean."""
    n = len(channels["alpha"])
    own = {
        name: jnp.asarray(channels[name]) if name in channels else jnp.full(n, jnp.mean(like.channels[name]))
        for name in like.recorded
    }
    time = np.arange(n) * dt
    return Flights(own | marks(n, dt), like.aircraft, np.zeros(n, int), time, (n,), ("standard",))


def _on_record(
    state: SelectionState,
    model: Model,
    flights: Flights,
    theta: Mapping[str, float],
    chosen: Sequence[Effect],
    noise: _Noise,
) -> tuple[SelectionState, _Noise]:
    """The problem linearised on a flown record, all outputs together."""
    active = tuple(e for e in state.active if e not in {c.name for c in chosen})
    full = replace(state.full, model=model, candidates=tuple(chosen))
    at = np.array([theta[name] for name in model.names])
    responses = EquationError.of(flights, model)
    noise = noise.of(responses.outputs)  # a manoeuvre with wings level says nothing of sideslip and bank
    there = linearised(full, responses, noise.outputs, at, active, variance_inflation=state.variance_inflation)
    X = np.asarray(there.responses.block(there.responses.evaluate(jnp.asarray(at))[1]["X"]))
    return replace(there, noise_growth=1.0 + noise.growth * (1.0 - X[:, None])), noise


def _judged(
    name: str, problem: tuple[SelectionState, _Noise], chosen: Sequence[Effect], worth: Mapping[str, float]
) -> Separation:
    state, noise = problem
    own = {e.name: _columns(state, e, worth) for e in chosen}
    members = np.concatenate([at for at, _ in own.values()])
    base = np.setdiff1d(state.columns(), members)
    S, weight, whole = state.scaled, 1.0 / noise.variance, [slice(0, len(state.residual))]

    def left(columns: Int[np.ndarray, " k"], signal: Float[np.ndarray, "m c"]) -> tuple[np.ndarray, float]:
        """What `columns`, held by their priors, cannot imitate of a signal; and the information in it."""
        A = S[:, :, columns]
        normal = np.einsum("mci,c,mcj->ij", A, weight, A, optimize=True) + np.diag(state.precision[columns])
        step = inverse(normal) @ np.einsum("mci,c,mc->i", A, weight, signal, optimize=True)
        rest = signal - A @ step
        return rest, float(np.einsum("mc,c,mc->", rest, weight, signal))

    signals = {e: [S[:, :, c] * size for c, size in zip(*own[e], strict=True)] for e in own}
    alone = {e: [left(base, s)[0] for s in rows] for e, rows in signals.items()}
    correlation = {}
    for a, b in combinations(own, 2):
        found = [_correlation(x, y, weight) for x in alone[a] for y in alone[b]]
        correlation[a, b] = max(found, key=abs)
    deviations = {}
    for a, b in permutations(own, 2):
        found = []
        for signal in signals[a]:
            rest, information = left(np.concatenate([base, own[b][0]]), signal)
            spread = float(noise.colour.meat(rest[:, :, None], noise.variance, whole)[0, 0])
            found.append(information / np.sqrt(spread) if spread > 0.0 else 0.0)
        deviations[a, b] = float(min(found))
    return Separation(name, correlation, deviations)


def _columns(
    state: SelectionState, effect: Effect, worth: Mapping[str, float]
) -> tuple[Int[np.ndarray, " w"], list[float]]:
    """Columns of an effect and the size of each; of one without slope at neutral, its least scanned value's column."""
    begin = len(state.theta) + len(state.offsets)
    scans = [(abs(s.value), begin + k, s) for k, s in enumerate(state.scans) if s.effect == effect.name]
    if scans:
        _, column, scan = min(scans, key=lambda row: row[0])
        at = state.theta[state.full.columns([scan.parameter])[0]]
        return np.array([column]), [float(scan.value - at)]
    names = [name for name in state.full.parameters_of(effect.name) if name in state.full.model.names]
    return state.full.columns(names), [worth[name] for name in names]


def _correlation(x: Float[np.ndarray, "m c"], y: Float[np.ndarray, "m c"], weight: Float[np.ndarray, " c"]) -> float:
    xx, yy, xy = (float(np.einsum("mc,c,mc->", a, weight, b)) for a, b in ((x, x), (y, y), (x, y)))
    return xy / np.sqrt(xx * yy) if xx > 0.0 and yy > 0.0 else float("nan")
