"""How often 95 % intervals hold the truth, on simulated stalls of the demo's 14 parameters.

    python benchmarks/interval_coverage.py colour 100 --out coverage     # coefficients, against colour and sample rate
    python benchmarks/interval_coverage.py identify 100 --out coverage   # pairs of flights, as `identify` fits them
    python benchmarks/interval_coverage.py report --out coverage         # tables of what is there
    python benchmarks/interval_coverage.py flown 30 --first 91000        # trajectories, the flight itself disturbed
    python benchmarks/interval_coverage.py band 40                       # in a band of frequencies, and in time

`colour`: coefficients of two manoeuvres simulated with AR(1) noise of one standard deviation and of lag-1 correlation
rho at a rate, in rounds of `ROUND` replicates of every cell. `identify`: pairs of stalls of 90 s, the demo's own or
random ones, with sensor noise alone (white) or with coloured disturbances besides (ar1), at 25 or 50 Hz, in turn:
maximum likelihood with corrected bounds, then the posterior by emcee under `--noise`. `flown`: parameters drawn for
each pair, fitted as `fly` does; sensors are noisy, those of recorded inputs too, in `ar1` and `buffet` the coefficients
as well. Those that write go on where they stopped.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from functools import partial
from itertools import product
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from studies import Z95, Row, mean_and_error, parser_of, print_inside, resumed, rows_of, seeds_of

from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.frequency import coefficients_in_band
from bayes_aero.inference.mle import fit_mle, without_noise_bias
from bayes_aero.inference.results import MleResult
from bayes_aero.inference.sampling import EnsembleLength, density_start, find_mode, sample_ensemble
from bayes_aero.jobs.fly import fly
from bayes_aero.jobs.options import FlyOptions
from bayes_aero.model.model import Model
from bayes_aero.model.observations import DEFAULT, Colour, Density, Noise, Observations, observe
from bayes_aero.physics.aircraft import NAMES
from bayes_aero.simulate.demo import TRUTH, Request, simulate_stall
from bayes_aero.simulate.injection import hidden_flights, synthetic

# Against colour and sample rate
STEPS = (4, 16)  # of 25 Hz: 6.25 and 1.5625 samples a second
RHOS = (0.0, 0.5, 0.9, 0.98)
SIGMA = {"sigma_CL": 0.02, "sigma_CD": 0.005, "sigma_Cm": 0.004}
ROUND = 10
METHODS = ("CRB", "corrected CRB", "white posterior", "AR(1) posterior")
# Of `identify`
KINDS = (("white", 0.04), ("white", 0.02), ("ar1", 0.04), ("ar1", 0.02), ("demo", 0.04))
IDENTIFIED = ("corrected bound", "posterior")
FIRST = 910_000  # of the seeds, apart from those on which the method was made
BAND = (0.05, 1.5)  # Hz


def bounds(mle: MleResult, sd: Float[np.ndarray, " k"]) -> Float[np.ndarray, "2 k"]:
    """Ends of 95 % intervals about the estimates."""
    return np.array([mle.estimate - Z95 * sd, mle.estimate + Z95 * sd])


def sampled(density: Density, mle: MleResult, seed: int, steps: int = 1000) -> tuple[Float[np.ndarray, "2 k"], str]:
    """Ends of the model parameters' posterior intervals, and how the sampler ended."""
    mode = find_mode(density, density_start(density, mle))
    found = sample_ensemble(density, mode, seed=seed, length=EnsembleLength(2, steps), predictive=False)
    return np.array([found.marginals[name].ci95 for name in mle.names]).T, found.status.name


def coverage_study(
    model: Model,
    observations: Observations,
    truth: Mapping[str, float],
    noise: Mapping[str, float],
    *,
    replicates: int,
    seed: int,
    white: int | None = None,
    max_steps: int = 1000,
) -> tuple[Float[np.ndarray, "replicates methods k"], float]:
    """Simulate coefficients from `truth` with AR(1) noise, infer them in four ways, see which parameters are covered.

    `observations` lend their signals only. Intervals: estimate +- 1.96 bounds, and equal-tailed posterior intervals.
    Every replicate is counted, converged or not; the second value is the share of posteriors that were. The posterior
    under white noise, which is there to be seen failing, is sampled for the first `white` replicates (default: all);
    NaN where it was not.
    """
    theta = np.array([truth[name] for name in model.names])
    maker = Density(observations, model, Noise(Colour.AR1))
    x_true = jnp.asarray(np.concatenate([theta, [noise[p.name] for p in maker.noise.parameters]]))
    rng, inside, status = np.random.default_rng(seed), [], []
    for number in range(replicates):
        draws = jnp.asarray(rng.standard_normal((observations.n, 3)))
        data = observations.with_measured(maker.replicate(x_true, draws))
        mle = fit_mle(model, data, start=theta, extra_starts=0)
        ends = [bounds(mle, mle.crb), bounds(mle, mle.crb_corrected)]
        for colour in (Colour.WHITE, Colour.AR1):
            if colour is Colour.WHITE and white is not None and number >= white:
                ends.append(np.full((2, len(theta)), np.nan))
                continue
            found, ended = sampled(Density(data, model, Noise(colour)), mle, number, max_steps)
            ends.append(found)
            status.append(ended == "CONVERGED")
        inside.append([np.where(np.isnan(low), np.nan, (low <= theta) & (theta <= high)) for low, high in ends])
    return np.array(inside), float(np.mean(status))


def cell(clean: Observations, model: Model, number: int, step: int, rho: float) -> Row:
    """A round of replicates of one cell: the share of parameters covered in each, by method."""
    noise = SIGMA | {f"rho_{name}": rho for name in NAMES}
    seed = 1000 * number + step
    inside, converged = coverage_study(model, clean.thinned(step), TRUTH, noise, replicates=ROUND, seed=seed)
    shares = dict(zip(METHODS, inside.mean(axis=2).T.tolist(), strict=True))
    return {"round": number, "step": step, "rho": rho, "inside": shares, "converged": converged}


def colour(count: int, path: Path) -> list[Row]:
    """Rounds of replicates of every cell until each has `count`."""
    card = read_card("attas")
    model = Model.from_card(card)
    records = [simulate_stall(i, card=card, sensor_noise=0.0, disturbance=0.0) for i in range(2)]
    every = product(range(-(-count // ROUND)), STEPS, RHOS)
    cases = {key: partial(cell, observe(records, card, model), model, *key) for key in every}
    return resumed(path, cases, lambda row: (row["round"], row["step"], row["rho"]), one_length=True)


def report_colour(rows: list[Row]) -> None:
    """Share covered in every cell, over parameters and replicates, with its standard error over replicates."""
    for step, rho in product(STEPS, RHOS):
        if here := [row for row in rows if (row["step"], row["rho"]) == (step, rho)]:
            each = {method: np.concatenate([row["inside"][method] for row in here]) for method in METHODS}
            cells = ["{} {:.3f} +- {:.3f}".format(method, *mean_and_error(x)) for method, x in each.items()]
            converged = np.mean([row["converged"] for row in here])
            print(f"{25.0 / step:g} samples a second, rho {rho:g}, {ROUND * len(here)} replicates "
                  f"({converged:.0%} converged): {'; '.join(cells)}")  # fmt: skip


def pair(kind: str, dt: float, number: int) -> list[FlightRecord]:
    """Two records of one kind; a stall that leaves the envelope is drawn anew."""
    if kind == "demo":
        return [simulate_stall(i, seed=FIRST + number) for i in range(2)]
    card, found = read_card("attas"), []
    for seed in range(FIRST + 100 * number, FIRST + 100 * number + 100):
        try:
            asked = Request({}, noise=kind, seed=seed, dt=dt)
            found.append(synthetic(asked, card, CATALOGUE, f"stall_{len(found) + 1}").record)
        except InputError:
            continue
        if len(found) == 2:
            break
    return found


def case(number: int, noise: Colour = DEFAULT, sample: bool = True) -> Row:
    """One pair, fitted: estimates, and the ends of every parameter's interval by method."""
    began, (kind, dt) = time.perf_counter(), KINDS[number % len(KINDS)]
    card = read_card("attas")
    model, records = Model.from_card(card), pair(kind, dt, number)
    observations = observe(records, card, model)
    mle = without_noise_bias(fit_mle(model, observations, seed=0), records, card, model)
    ends, status = {IDENTIFIED[0]: bounds(mle, mle.crb_corrected).T.tolist()}, ""
    if sample:
        found, status = sampled(Density.of(observations, model, Noise(noise), mle.bias), mle, number)
        ends[IDENTIFIED[1]] = found.T.tolist()
    row = {"seed": number, "kind": kind, "dt": dt, "names": model.names, "estimate": mle.estimate.tolist()}
    row |= {"ends": ends, "mle": mle.status.name, "posterior": status}
    return row | {"seconds": time.perf_counter() - began}


def report_identified(rows: list[Row]) -> None:
    """Shares of the truths inside, by kind and by parameter, with their standard errors over pairs."""
    names = rows[0]["names"]
    truth = np.array([TRUTH[name] for name in names])
    for method in IDENTIFIED:
        having = [row for row in rows if method in row["ends"]]
        if not having:
            continue
        ends = np.array([row["ends"][method] for row in having])
        inside = (ends[..., 0] <= truth) & (truth <= ends[..., 1])
        ended = dict(Counter(r["posterior"].lower() for r in having)) if method == IDENTIFIED[1] else ""
        print(f"\n{method}: {len(having)} pairs {ended}")
        print_inside(names, inside)
        for kind, dt in KINDS:
            here = np.array([row["kind"] == kind and row["dt"] == dt for row in having])
            if here.any():
                print(f"  {kind:5} {1 / dt:g} Hz: {inside[here].mean():.3f} ({here.sum()} pairs)")
    worst = np.median([np.array(row["estimate"]) - truth for row in rows], axis=0) / np.abs(truth)
    print("\nmedian error: " + ", ".join(f"{n} {x:+.2%}" for n, x in zip(names, worst, strict=True)))


def flown(seeds: range) -> None:
    """Pairs of stalls for each kind of noise, by output error."""
    card = read_card("attas")
    for noise in ("white", "ar1", "buffet"):
        white, corrected, lost = [], [], 0
        for seed in seeds:
            jax.clear_caches()  # a process holds only so many programs
            flights = hidden_flights({}, seed=seed, seconds=90.0, noise=noise)
            found = fly([f.record for f in flights], card, FlyOptions(figures=False)).flown
            if not found.converged:
                lost += 1
                continue
            off = found.fit.estimate - np.array([flights[0].values[name] for name in found.fit.names])
            white.append(off / found.fit.sd)
            corrected.append(off / found.fit.sd_corrected)
            print(noise, seed, f"{np.mean(np.abs(corrected[-1]) < 1.96):.2f}", flush=True)
        for name, z in (("Cramer-Rao", np.array(white)), ("corrected", np.array(corrected))):
            inside, spread = np.mean(np.abs(z) < 1.96), np.median(np.sqrt(np.mean(z**2, axis=0)))
            print(f"{noise}: {name}: {inside:.2f} inside 95 %; off by {spread:.1f} deviations (RMS, median parameter)")
        print(f"{noise}: {len(white)} fitted, {lost} did not converge", flush=True)


def band(stalls: int, seed: int) -> None:
    """Both domains on simulated stalls: differences in standard errors, and errors of either."""
    card = read_card("attas")
    model, apart, inside = Model.from_card(card), [], []
    for number in range(stalls):
        records = [simulate_stall(i, seed=seed + number) for i in range(2)]
        mle = fit_mle(model, observe(records, card, model), extra_starts=0)
        mle = without_noise_bias(mle, records, card, model)
        fit = coefficients_in_band(records, card, model, mle, BAND)
        place = [mle.names.index(name) for name in fit.names]
        truth = np.array([TRUTH[name] for name in fit.names])
        apart.append(list(fit.apart.values()))
        off = (mle.estimate[place] - truth) / mle.crb_corrected[place], (fit.estimate - truth) / fit.crb_corrected
        inside.append(np.abs(off) < Z95)
    in_time, in_band = np.mean(inside, axis=(0, 2))
    print(f"{stalls} pairs of stalls: 95 % intervals with the truth, time {in_time:.1%}, band {in_band:.1%}")
    shares = [np.mean(np.abs(apart) < Z95), np.mean(np.array(apart) > 3.0)]
    print("differences within 1.96 standard errors {:.1%}, above 3 {:.1%}".format(*shares))


def main() -> None:
    parser = parser_of(__doc__, "coverage", ("colour", "identify", "report", "flown", "band"), first=91000, count=100)
    parser.add_argument("--noise", type=Colour, choices=list(Colour), default=DEFAULT, help="of the posterior")
    parser.add_argument("--no-posterior", dest="sample", action="store_false", help="corrected bounds alone")
    given = parser.parse_args()
    cells, pairs = given.out / "colour.jsonl", given.out / "pairs.jsonl"
    if given.what == "flown":
        flown(seeds_of(given))
    elif given.what == "band":
        band(given.count, 1)
    else:
        if given.what == "colour":
            colour(given.count, cells)
        elif given.what == "identify":
            cases = {k: partial(case, k, given.noise, given.sample) for k in range(given.count)}
            resumed(pairs, cases, one_length=True)
        report_colour(rows_of(cells))
        if rows := rows_of(pairs):
            report_identified(rows)


if __name__ == "__main__":
    main()
