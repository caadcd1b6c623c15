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

import json
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float
from studies import Z95, Row, mean_and_error, parser_of, resumed, rows_of, seeds_of

from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.frequency import coefficients_in_band
from bayes_aero.inference.mle import fit_mle, without_noise_bias
from bayes_aero.inference.sampling import EnsembleLength, density_start, find_mode, sample_ensemble
from bayes_aero.jobs.fly import fly
from bayes_aero.model.model import Model
from bayes_aero.model.observations import DEFAULT, Colour, Density, Noise, Observations, observe
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


@dataclass(frozen=True)
class Coverage:
    """`inside[m, r, k]` is 1 where method m's interval of parameter k covered the truth in replicate r, else 0; NaN
    where it was not tried."""

    names: tuple[str, ...]
    inside: Float[np.ndarray, "methods replicates k"]
    converged: Float[np.ndarray, " replicates"]

    def table(self) -> pd.DataFrame:
        """Share covered, a row per parameter and one for all, a column per method."""
        shares = pd.DataFrame(np.nanmean(self.inside, axis=1).T, index=list(self.names), columns=list(METHODS))
        shares.loc["all"] = shares.mean()
        return shares


def coverage_study(
    model: Model,
    observations: Observations,
    truth: Mapping[str, float],
    noise: Mapping[str, float],
    *,
    replicates: int,
    seed: int,
    white: int | None = None,
    ensembles: int = 2,
    max_steps: int = 1000,
) -> Coverage:
    """Simulate coefficients from `truth` with AR(1) noise, infer them in four ways, count covered parameters.

    `observations` lend their signals only. Intervals: estimate +- 1.96 bounds, and equal-tailed posterior intervals.
    Every replicate is counted, converged or not; `converged` is the share of its posteriors that were. The posterior
    under white noise, which is there to be seen failing, is sampled for the first `white` replicates (default: all).
    """
    theta = np.array([truth[name] for name in model.names])
    maker = Density(observations, model, Noise(Colour.AR1))
    x_true = jnp.asarray(np.concatenate([theta, [noise[p.name] for p in maker.noise.parameters]]))
    rng = np.random.default_rng(seed)
    inside, good = [], []
    for replicate in range(replicates):
        draws = jnp.asarray(rng.standard_normal((observations.n, 3)))
        data = observations.with_measured(maker.replicate(x_true, draws))
        mle = fit_mle(model, data, start=theta, extra_starts=0)
        low = [mle.estimate - Z95 * mle.crb, mle.estimate - Z95 * mle.crb_corrected]
        high = [mle.estimate + Z95 * mle.crb, mle.estimate + Z95 * mle.crb_corrected]
        sound = []
        for colour in (Colour.WHITE, Colour.AR1):
            if colour is Colour.WHITE and white is not None and replicate >= white:
                low.append(np.full(len(theta), np.nan))
                high.append(np.full(len(theta), np.nan))
                continue
            density = Density(data, model, Noise(colour))
            mode = find_mode(density, density_start(density, mle))
            posterior = sample_ensemble(
                density, mode, seed=replicate, length=EnsembleLength(ensembles, max_steps), predictive=False
            )
            ends = np.array([posterior.marginals[name].ci95 for name in model.names])
            low.append(ends[:, 0])
            high.append(ends[:, 1])
            sound.append(posterior.status.name == "CONVERGED")
        inside.append(
            [np.where(np.isnan(a), np.nan, (a <= theta) & (theta <= b)) for a, b in zip(low, high, strict=True)]
        )
        good.append(np.mean(sound))
    return Coverage(model.names, np.swapaxes(np.array(inside), 0, 1), np.array(good))


def colour(count: int, out: Path) -> None:
    """Rounds of replicates of every cell until each has `count`."""
    out.mkdir(parents=True, exist_ok=True)
    card = read_card("attas")
    model = Model.from_card(card)
    records = [simulate_stall(i, card=card, sensor_noise=0.0, disturbance=0.0) for i in range(2)]
    clean = observe(records, card, model)
    for number in range(-(-count // ROUND)):
        for step in STEPS:
            for rho in RHOS:
                path = out / f"step{step}_rho{rho:g}_round{number}.json"
                if path.exists():
                    continue
                noise = SIGMA | {f"rho_{name}": rho for name in ("CL", "CD", "Cm")}
                thinned, seed = clean.thinned(step), 1000 * number + step
                found = coverage_study(model, thinned, TRUTH, noise, replicates=ROUND, seed=seed)
                inside = dict(zip(METHODS, found.inside.mean(axis=2).tolist(), strict=True))  # a share a replicate
                row = {"step": step, "rho": rho, "inside": inside, "converged": float(found.converged.mean())}
                path.write_text(json.dumps(row))


def report_colour(out: Path) -> None:
    """Share covered in every cell, over parameters and replicates, with its standard error over replicates."""
    rows = [json.loads(path.read_text()) for path in sorted(out.glob("step*.json"))]
    for step in sorted({row["step"] for row in rows}):
        print(f"\n{25.0 / step:g} samples a second")
        for rho in RHOS:
            here = [row for row in rows if row["step"] == step and row["rho"] == rho]
            if not here:
                continue
            cells = []
            for method in METHODS:
                each = np.concatenate([row["inside"][method] for row in here])
                cells.append("{} {:.3f} +- {:.3f}".format(method, *mean_and_error(each)))
            converged = np.mean([row["converged"] for row in here])
            print(f"  rho {rho:g}, {ROUND * len(here)} replicates ({converged:.0%} converged): {'; '.join(cells)}")


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
    sd = mle.crb_corrected
    ends = {IDENTIFIED[0]: np.stack([mle.estimate - Z95 * sd, mle.estimate + Z95 * sd], axis=1).tolist()}
    status = ""
    if sample:
        density = Density.of(observations, model, Noise(noise), mle.bias)
        mode = find_mode(density, density_start(density, mle))
        posterior = sample_ensemble(density, mode, seed=number, length=EnsembleLength(2, 1000), predictive=False)
        ends[IDENTIFIED[1]] = [list(posterior.marginals[name].ci95) for name in model.names]
        status = posterior.status.name
    row = {"seed": number, "kind": kind, "dt": dt, "names": model.names, "estimate": mle.estimate.tolist()}
    row |= {"ends": ends, "mle": mle.status.name, "posterior": status}
    return row | {"seconds": time.perf_counter() - began}


def report_identified(rows: list[Row]) -> None:
    """Shares of the truths inside, by kind and by parameter, with their standard errors over pairs."""
    truth = np.array([TRUTH[name] for name in rows[0]["names"]])
    print(f"{len(rows)} pairs")
    for method in IDENTIFIED:
        having = [row for row in rows if method in row["ends"]]
        if not having:
            continue
        ends = np.array([row["ends"][method] for row in having])
        inside = (ends[..., 0] <= truth) & (truth <= ends[..., 1])
        print("\n{}: {} pairs, {:.3f} +- {:.3f}".format(method, len(having), *mean_and_error(inside.mean(axis=1))))
        if method == IDENTIFIED[1]:
            print("  status:", dict(Counter(r["posterior"].lower() for r in having)))
        for kind, dt in KINDS:
            here = np.array([row["kind"] == kind and row["dt"] == dt for row in having])
            if here.any():
                print(f"  {kind:5} {1 / dt:g} Hz: {inside[here].mean():.3f} ({here.sum()} pairs)")
        print("  " + ", ".join(f"{n} {x:.2f}" for n, x in zip(rows[0]["names"], inside.mean(axis=0), strict=True)))
    worst = np.median([np.array(row["estimate"]) - truth for row in rows], axis=0) / np.abs(truth)
    print("\nmedian error: " + ", ".join(f"{n} {x:+.2%}" for n, x in zip(rows[0]["names"], worst, strict=True)))


def flown(seeds: range) -> None:
    """Pairs of stalls for each kind of noise, by output error."""
    card = read_card("attas")
    for noise in ("white", "ar1", "buffet"):
        white, corrected, lost = [], [], 0
        for seed in seeds:
            jax.clear_caches()  # a process holds only so many programs
            flights = hidden_flights({}, seed=seed, seconds=90.0, noise=noise)
            found = fly([f.record for f in flights], card, figures=False).flown
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
    model, apart, inside, wider = Model.from_card(card), [], [], []
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
        wider.append([np.median(fit.crb_corrected / fit.crb), np.median(mle.crb_corrected / mle.crb)])
    in_time, in_band = np.mean(inside, axis=(0, 2))
    print(f"{stalls} pairs of stalls: 95 % intervals with the truth, time {in_time:.1%}, band {in_band:.1%}")
    shares = [np.mean(np.abs(apart) < Z95), np.mean(np.array(apart) > 3.0)]
    print("differences within 1.96 standard errors {:.1%}, above 3 {:.1%}".format(*shares))
    print("corrected over plain bound, band {:.2f}, time {:.1f}".format(*np.median(wider, axis=0)))


def main() -> None:
    """Run a study, or report on what is there."""
    parser = parser_of(__doc__, "coverage", ("colour", "identify", "report", "flown", "band"), first=91000, count=100)
    parser.add_argument("--noise", type=Colour, choices=list(Colour), default=DEFAULT, help="of the posterior")
    parser.add_argument("--no-posterior", dest="sample", action="store_false", help="corrected bounds alone")
    given = parser.parse_args()
    pairs = given.out / "pairs.jsonl"
    if given.what == "colour":
        colour(given.count, given.out)
    elif given.what == "identify":
        cases = {k: partial(case, k, given.noise, given.sample) for k in range(given.count)}
        report_identified(resumed(pairs, cases, one_length=True))
    elif given.what == "flown":
        flown(seeds_of(given))
    elif given.what == "band":
        band(given.count, 1)
    else:
        if any(given.out.glob("step*.json")):
            report_colour(given.out)
        if pairs.exists():
            report_identified(rows_of(pairs))


if __name__ == "__main__":
    main()
