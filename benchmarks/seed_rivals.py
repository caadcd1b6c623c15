"""Networks, Gaussian processes and equations on honest splits: r, RMSE, log score, coverage, time and spread.

    pip install -e '.[peers]'
    python benchmarks/seed_rivals.py RECORD RECORD [--out rivals]
    python benchmarks/seed_rivals.py RECORD RECORD --random-splits 10    # of samples: process against equations

Two manoeuvres of the `attas` card, their coefficients as means of 0.2 s (1010 blocks), the inputs those of [gp]. One
random, one block split, and each manoeuvre from the other; ten initialisations of every method on the same splits. One
line of OUT/rivals.jsonl each; a run that was interrupted goes on.

The size of a network is chosen by an inner hold-out inside the training part, and so is its noise: none of them has a
predictive distribution, so each gets a normal one with the mean square error of that inner hold-out. The final network
is then trained on the whole training part.

`--random-splits`: the Gaussian process, its hyperparameters at their mode, and maximum likelihood on random 70/30
splits of the samples, as the paper has them, with the margins that it states. Seed 0 gets the full search, every other
seed starts from that optimum.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import least_squares
from studies import plain_parser, records_of, resumed

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.selection import measured_blocks, truncated
from bayes_aero.diagnosis.selection_state import moved, optimum
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import log_density
from bayes_aero.inference.gp import KINDS, Budget, SplitKind, fit_gp, gaussian_parts, gp_inputs, make_splits
from bayes_aero.inference.gp_kernel import Priors, ReducedData, Scaling, find_map, maximise
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.results import score
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.physics.aircraft import NAMES

Predict = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Problem:
    """Blocks of about 0.2 s of all manoeuvres: `inputs` (m, d) of the regression, coefficients `measured` (m, c).

    `states` (m, s) are those that the one-step network propagates. `train` and, inside it, `inner` mark blocks.
    """

    inputs: Float[np.ndarray, "m d"]
    measured: Float[np.ndarray, "m c"]
    states: Float[np.ndarray, "m s"]
    manoeuvre: Int[np.ndarray, " m"]
    train: Bool[np.ndarray, " m"]
    inner: Bool[np.ndarray, " m"]


class Guess(NamedTuple):
    """Mean and deviation at every block; what was chosen, and the processor seconds that choosing took."""

    mean: Float[np.ndarray, "m c"]
    sd: Float[np.ndarray, "m c"]
    chosen: str = ""
    choosing: float = 0.0


def network(X: np.ndarray, y: np.ndarray, units: int, decay: float, seed: int) -> Predict:
    """One hidden layer of tanh, weight decay, L-BFGS to its end; inputs and outputs scaled."""
    from sklearn.compose import TransformedTargetRegressor
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    net = MLPRegressor(
        hidden_layer_sizes=(units,), activation="tanh", solver="lbfgs", alpha=decay, max_iter=2000, random_state=seed
    )
    scaled = TransformedTargetRegressor(make_pipeline(StandardScaler(), net), transformer=StandardScaler())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of fits that end at the largest number of iterations
        return scaled.fit(X, y).predict


def basis(X: np.ndarray, y: np.ndarray, centres: int, width: float, ridge: float, seed: int) -> Predict:
    """Gaussian basis functions about the centres of k-means, weights by ridge regression."""
    from sklearn.cluster import KMeans
    from sklearn.linear_model import Ridge
    from sklearn.metrics.pairwise import rbf_kernel
    from sklearn.preprocessing import StandardScaler

    scale, gamma = StandardScaler().fit(X).transform, 0.5 / width**2
    places = KMeans(centres, n_init=1, random_state=seed).fit(scale(X)).cluster_centers_
    fit = Ridge(ridge).fit(rbf_kernel(scale(X), places, gamma), y)
    return lambda new: fit.predict(rbf_kernel(scale(new), places, gamma))


def by_inner_holdout(
    fitted: Callable[..., Predict], settings: list[tuple], problem: Problem, seed: int
) -> tuple[list[tuple], Float[np.ndarray, " c"], float]:
    """The best of the settings for each coefficient, its root mean square error, and the seconds it took."""
    began = time.process_time()
    X, z, p = problem.inputs, problem.measured, problem
    fit = p.train & ~p.inner
    errors = np.array([
        [np.mean((z[p.inner, c] - fitted(X[fit], z[fit, c], *one, seed)(X[p.inner])) ** 2) for c in range(z.shape[1])]
        for one in settings
    ])  # fmt: skip
    best = np.argmin(errors, axis=0)
    return [settings[i] for i in best], np.sqrt(errors.min(axis=0)), time.process_time() - began


def static(fitted: Callable[..., Predict], settings: list[tuple], problem: Problem, seed: int) -> Guess:
    """One network for each coefficient, as there is one Gaussian process for each."""
    chosen, error, seconds = by_inner_holdout(fitted, settings, problem, seed)
    X, z, train = problem.inputs, problem.measured, problem.train
    means = [fitted(X[train], z[train, c], *one, seed)(X) for c, one in enumerate(chosen)]
    sizes = "/".join(str(one[0]) for one in chosen)
    return Guess(np.stack(means, axis=1), np.tile(error, (len(X), 1)), sizes, seconds)


def perceptron(problem: Problem, seed: int) -> Guess:
    return static(network, [(u, d) for u in (2, 4, 8, 16) for d in (0.01, 1.0)], problem, seed)


def radial_basis(problem: Problem, seed: int) -> Guess:
    grid = [(k, w, r) for k in (5, 20, 80) for w in (1.0, 2.0, 4.0, 8.0) for r in (1e-3, 1e-1)]
    return static(basis, grid, problem, seed)


def one_step(problem: Problem, seed: int, modelled: Callable[[np.ndarray], np.ndarray], start: np.ndarray, bounds: Any):
    """Neural Gauss-Newton: a network in place of the equations of motion, under the coefficients of a model.

    The network learns the next states from the present states and measured coefficients. Then Gauss-Newton finds the
    parameters whose coefficients, put into it, predict the next states best; the network is differenced.

    Source: N. K. Peyada and A. K. Ghosh, Aeronautical Journal 113 (1142), 2009: the scheme; one step at a time here.
    """
    began = time.process_time()
    p, x, z = problem, problem.states, problem.measured
    follows = np.append((p.manoeuvre[1:] == p.manoeuvre[:-1]), False)
    change = np.vstack([np.diff(x, axis=0), np.zeros((1, x.shape[1]))])

    def pairs(rows: np.ndarray) -> np.ndarray:
        return np.flatnonzero(rows & np.append(rows[1:], False) & follows)

    both = np.hstack([x, z])
    fit, held, train = pairs(p.train & ~p.inner), pairs(p.inner), pairs(p.train)
    errors = {
        units: np.sum(np.mean((change[held] - network(both[fit], change[fit], units, 1e-2, seed)(both[held])) ** 2, 0)
                      / change[fit].var(axis=0)) for units in (2, 4, 8, 16)
    }  # fmt: skip
    units = min(errors, key=lambda k: errors[k])
    seconds = time.process_time() - began
    net = network(both[train], change[train], units, 1e-2, seed)
    noise = (change[train] - net(both[train])).std(axis=0)

    def residual(theta: np.ndarray) -> np.ndarray:
        predicted = net(np.hstack([x, modelled(theta)])[train])
        return ((change[train] - predicted) / noise).ravel()

    found = least_squares(residual, start, bounds=bounds, x_scale=np.maximum(np.abs(start), 1e-2), max_nfev=60)
    mean = modelled(found.x)
    sd = np.sqrt(np.mean((z - mean)[p.train] ** 2, axis=0))
    return Guess(mean, np.tile(sd, (len(z), 1)), str(units), seconds)


STATES = ("alpha", "q", "airspeed", "theta")
INNER: dict[SplitKind, SplitKind] = {"random": "random", "block": "block", "manoeuvre": "block"}  # its inner hold-out
STEPS = 40  # Gauss-Newton steps of the extended model
FEWER = {"GPR, sampled": 3}  # initialisations where ten take too long


class Flights:
    """Records, the diagnosis of both and of each alone, and everything at the blocks."""

    def __init__(self, card: Card, records: Sequence[FlightRecord]) -> None:
        self.card, self.model = card, Model.from_card(card)
        self.seen = observe(records, card, self.model)
        began = time.process_time()
        found = diagnose(records, card)
        self.diagnosing = time.process_time() - began
        self.kept = tuple(found.kept)
        self.state = truncated(found.aerodynamics.state, found.kept)
        responses = self.state.responses
        self.manoeuvre = responses.manoeuvre
        self.sample_block = np.full(self.seen.n, -1)
        lengths = [int(np.sum(self.seen.manoeuvre == k)) for k in np.unique(self.seen.manoeuvre)]
        step, begin, block = round(responses.seconds / self.seen.dt), 0, 0
        for length in lengths:
            count = length // step
            self.sample_block[begin : begin + count * step] = block + np.repeat(np.arange(count), step)
            begin, block = begin + length, block + count
        signals = self.seen.signals
        self.inputs = np.stack([self.blocks(signals[n]) for n in self.card.gp_inputs], axis=1)
        self.states = np.stack([self.blocks(signals[n]) for n in STATES], axis=1)
        self.measured = measured_blocks(self.state)
        self._predicted = jax.jit(lambda theta: self.model.predicted(theta, signals, self.seen.aircraft))

    def blocks(self, x) -> np.ndarray:
        return np.asarray(self.state.responses.block(x * 1.0))

    def modelled(self, theta: np.ndarray) -> Float[np.ndarray, "m c"]:
        """The card's model at the blocks."""
        return self.blocks(self._predicted(theta))

    def start(self, seed: int) -> np.ndarray:
        """The card's start for seed 0, else a draw from the priors."""
        if seed == 0:
            return np.array([p.start for p in self.model.free])
        rng = np.random.default_rng(seed)
        drawn = [float(p.prior.sample(rng, 1)[0]) for p in self.model.free]
        return np.array([np.clip(x, *p.bounds) for x, p in zip(drawn, self.model.free, strict=True)])


def likelihood(flights: Flights, problem: Problem, seed: int, others: int = 6) -> tuple[Guess, np.ndarray]:
    """Maximum likelihood of the card's model on all samples of the training blocks, the best of 1 + `others` starts."""
    samples = np.flatnonzero((flights.sample_block >= 0) & problem.train[flights.sample_block])
    found = fit_mle(
        flights.model, flights.seen.subset(samples), start=flights.start(seed), extra_starts=others, seed=seed
    )
    mean = flights.modelled(found.estimate)
    sd = np.sqrt(np.mean((problem.measured - mean)[problem.train] ** 2, axis=0))  # that the fit itself estimates
    return Guess(mean, np.tile(sd, (len(mean), 1))), found.estimate


def extended(flights: Flights, problem: Problem, seed: int, kept: Sequence[str]) -> Guess:
    """The card's model with these causes; from maximum likelihood, the causes at neutral."""
    _, estimate = likelihood(flights, problem, seed)
    state = flights.state
    theta = state.full.neutral_vector.copy()
    theta = state.full.card_only(np.where(np.isfinite(theta), theta, state.theta))
    theta[state.full.columns(flights.model.names)] = estimate
    state = replace(moved(state, theta, tuple(kept)), folds=_runs(problem.train))
    theta = optimum(state, range(len(state.folds)), STEPS)
    residual = np.asarray(state.responses.evaluate(theta)[0])[:, : len(NAMES)]
    variance = np.mean((residual / state.noise_growth)[problem.train] ** 2, axis=0)
    return Guess(problem.measured - residual, np.sqrt(variance) * state.noise_growth, ", ".join(kept))


def _runs(rows: Bool[np.ndarray, " m"]) -> tuple[slice, ...]:
    """Contiguous stretches of the marked blocks."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rows.astype(int), [0]])))
    return tuple(slice(int(a), int(b)) for a, b in edges.reshape(-1, 2))


def process(flights: Flights, problem: Problem, seed: int, sample: bool) -> Guess:
    """This program's Gaussian process with its defaults, one for each coefficient."""
    means, sds, ended = [], [], []
    for c, name in enumerate(NAMES):
        fit = fit_gp(
            problem.inputs[problem.train], problem.measured[problem.train, c], names=(*flights.card.gp_inputs, name),
            priors=Priors.quasi_steady(), sample=sample, budget=Budget(seed=seed),
        )  # fmt: skip
        there = fit.predict(problem.inputs)
        means.append(there.mean)
        sds.append(there.sd)
        ended.append(fit.status.name if sample else fit.map_status.name)
    return Guess(np.stack(means, axis=1), np.stack(sds, axis=1), "/".join(ended))


def neural_gauss_newton(flights: Flights, problem: Problem, seed: int) -> Guess:
    bounds = np.array([p.bounds for p in flights.model.free])
    start = np.clip(flights.start(0), bounds[:, 0] + 1e-6, bounds[:, 1] - 1e-6)
    return one_step(problem, seed, flights.modelled, start, bounds.T)


def methods(flights: Flights) -> Mapping[str, Callable[[Problem, int], Guess]]:
    """In the order of the table."""
    return {
        "perceptron": perceptron,
        "radial basis": radial_basis,
        "one-step (NGN)": partial(neural_gauss_newton, flights),
        "GPR, MAP": lambda p, s: process(flights, p, s, False),
        "GPR, sampled": lambda p, s: process(flights, p, s, True),
        "maximum likelihood": lambda p, s: likelihood(flights, p, s)[0],
        "extended": lambda p, s: extended(flights, p, s, flights.kept),
    }


def problems(flights: Flights, kind: SplitKind) -> list[Problem]:
    """The folds of a split, each with an inner hold-out of the training part."""
    seconds, found = flights.state.responses.seconds, []
    for fold in make_splits(kind, flights.manoeuvre, seconds, 0):
        inner = make_splits(INNER[kind], flights.manoeuvre[fold.train_idx], seconds, 1)[0]
        train, held = np.zeros((2, len(flights.manoeuvre)), bool)
        train[fold.train_idx] = True
        held[fold.train_idx[inner.test_idx]] = True
        found.append(Problem(flights.inputs, flights.measured, flights.states, flights.manoeuvre, train, held))
    return found


def case(flights: Flights, kind: SplitKind, name: str, seed: int) -> dict:
    """Every fold of one split by one method and initialisation: scores over all that was held out."""
    mean, sd = np.full((2, *flights.measured.shape), np.nan)
    seconds, choosing, chosen = [], [], []
    for problem in problems(flights, kind):
        method = methods(flights)[name]
        began = time.process_time()
        guess = method(problem, seed)
        seconds.append(time.process_time() - began)
        choosing.append(guess.choosing)
        chosen.append(guess.chosen)
        mean[~problem.train], sd[~problem.train] = guess.mean[~problem.train], guess.sd[~problem.train]
    test = np.isfinite(mean[:, 0])
    row = {"split": kind, "method": name, "seed": seed, "chosen": chosen}
    row |= {"seconds": float(np.mean(seconds)), "choosing": float(np.mean(choosing))}
    for c, coefficient in enumerate(NAMES):
        z, y, s = flights.measured[test, c], mean[test, c], sd[test, c]
        found = score(z, y)
        row[coefficient] = {
            "r": found.r, "rmse": found.rmse, "log": float(log_density(z - y, s**2).mean()),
            "coverage": float(np.mean(np.abs(z - y) <= 1.959964 * s)),
        }  # fmt: skip
    return row


def table(rows: Sequence[dict]) -> None:
    """A line for each split and method: medians over initialisations, and the worst over the best of them."""
    print("CL / CD / Cm of all that was held out; seconds of the processor for one training")
    print(
        "| split | method | r | RMSE, 1e-3 | worst over best RMSE | log score | in 95 % | s | choosing | of GPR, MAP |"
    )
    print("|" + "---|" * 10)
    names = dict.fromkeys(r["method"] for r in rows)
    for kind in KINDS:
        of = {name: [r for r in rows if (r["split"], r["method"]) == (kind, name)] for name in names}
        base = np.median([r["seconds"] for r in of["GPR, MAP"]])
        for name, own in of.items():
            if not own:
                continue
            each = {k: np.array([[r[c][k] for c in NAMES] for r in own]) for k in ("r", "rmse", "log", "coverage")}
            middle = {k: np.median(x, axis=0) for k, x in each.items()}
            worst = each["rmse"].max(axis=0) / each["rmse"].min(axis=0)
            seconds, choosing = (np.median([r[k] for r in own]) for k in ("seconds", "choosing"))
            cells = [kind, name, _three(middle["r"], ".3f"), _three(1e3 * middle["rmse"], ".1f")]
            cells += [_three(worst, ".2f") if len(own) > 1 else "-", f"{middle['log'].sum():.2f}"]
            cells += [_three(100.0 * middle["coverage"], ".0f"), f"{seconds:.2g}"]
            cells += [f"{choosing / seconds:.0%}", f"{seconds / base:.2g} x"]
            print("| " + " | ".join(cells) + " |")


def _three(values: Float[np.ndarray, " c"], digits: str) -> str:
    return " / ".join(format(x, digits) for x in values)


ASKED = {"CL": 0.0015, "CD": 0.005, "Cm": 0.40}  # margins in r that the paper states


def random_splits(card: Card, records: Sequence[FlightRecord], seeds: int) -> None:
    """Print a row for each seed and coefficient as it is done, and the mean margins."""
    model, priors = Model.from_card(card), Priors.quasi_steady()
    seen = observe(records, card, model)
    X, z, start = gp_inputs(seen, card.gp_inputs), np.asarray(seen.measured), fit_mle(model, seen).estimate
    margins: dict[str, list[tuple[float, float]]] = {name: [] for name in NAMES}
    first = {}
    print("seed coef  GPR r    RMSE      MLE r    RMSE      margin r  RMSE ratio  log posterior")
    for seed, (i, name) in product(range(seeds), enumerate(NAMES)):
        fold = make_splits("random", seen.manoeuvre, seen.dt, seed)[0]
        if i == 0:
            trained = fit_mle(model, seen.subset(fold.train_idx), start=start, extra_starts=0)
            predicted = np.asarray(model.predicted(jnp.asarray(trained.estimate), seen.signals, seen.aircraft))
        scaling = Scaling.of(X[fold.train_idx], z[fold.train_idx, i], card.gp_inputs)
        data = ReducedData.of(scaling.inputs(X[fold.train_idx]), z[fold.train_idx, i] / scaling.rms)
        best = first.get(name)
        best = maximise(best.u, data, priors, w=best.theta[:6]) if best else find_map(data, priors, seed=seed)[0]
        first.setdefault(name, best)
        mean, _ = gaussian_parts(best.theta, data, scaling.inputs(X[fold.test_idx]))
        gp, mle = (score(z[fold.test_idx, i], y) for y in (scaling.rms * mean, predicted[fold.test_idx, i]))
        margins[name].append((gp.r - mle.r, gp.rmse / mle.rmse))
        print(f"{seed:4d} {name:4s} {gp.r:.5f}  {gp.rmse:.6f}  {mle.r:.5f}  {mle.rmse:.6f}  {gp.r - mle.r:+.5f}  "
              f"{gp.rmse / mle.rmse:10.3f}  {best.value:13.3f}", flush=True)  # fmt: skip
    for name, rows in margins.items():
        r, rmse = np.array(rows).T
        reached = f"least {r.min():+.5f}, reached in {np.sum(r >= ASKED[name])} of {len(r)}"
        print(f"mean {name}: margin in r {r.mean():+.5f} (asked {ASKED[name]:+.4f}, {reached}), "
              f"RMSE ratio {rmse.mean():.3f} (worst {rmse.max():.3f})")  # fmt: skip


def main() -> None:
    parser = plain_parser(__doc__)
    parser.add_argument("--out", type=Path, default=Path("rivals"))
    parser.add_argument("--initialisations", type=int, default=10)
    parser.add_argument("--methods", nargs="+")
    parser.add_argument("--random-splits", type=int, default=0, metavar="SEEDS", help="these alone")
    given, card, records = records_of(parser)
    if given.random_splits:
        random_splits(card, records, given.random_splits)
        return
    flights = Flights(card, records)
    print(f"diagnosis {flights.diagnosing:.0f} s: {', '.join(flights.kept)}", flush=True)
    asked = product(range(given.initialisations), given.methods or methods(flights), INNER)
    asked = [(kind, name, seed) for seed, name, kind in asked if seed < FEWER.get(name, 1 + seed)]
    cases = {one: partial(case, flights, *one) for one in asked}
    key = lambda row: (row["split"], row["method"], row["seed"])  # noqa: E731
    rows = resumed(given.out / "rivals.jsonl", cases, key, one_length=True)
    order = list(methods(flights))
    rows.sort(key=lambda r: order.index(r["method"]))
    table(rows)


if __name__ == "__main__":
    main()
