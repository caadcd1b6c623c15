"""Is the pooling of manoeuvres calibrated, and does its normal approximation hold?

    python benchmarks/next_flight.py ranks [--replicates 500] [--manoeuvres 2 9]
    python benchmarks/next_flight.py flights [--aircraft 40] [--manoeuvres 4]
    python benchmarks/next_flight.py density [--manoeuvres 3]

`ranks` is simulation-based calibration: aircraft, scatter and manoeuvres are drawn from their priors, estimates with
correlated errors follow, one manoeuvre says nothing of one parameter. Ranks of aircraft, scatter, first manoeuvre and
next flight must be uniform, and intervals must contain a next flight as often as they say.

`flights` goes through the whole of `identify --next-flight`: stalls of one aircraft whose parameters scatter, simulated
with sensor noise and buffet; the true parameters of one more stall are looked for in the intervals.

`density` samples the hierarchy over the full density of the coefficients, with the parameters of every manoeuvre and
the noise, beside the normal approximation: white noise, so that both assume the same.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from hierarchy_density import compare
from hierarchy_flights import fly_again
from ranks import band_of, rank

from bayes_aero.inference.posterior.nuts import NutsLength, WarmUp
from bayes_aero.inference.posterior.pooled.hierarchy import SCATTER, Hierarchy, pool

NAMES = ("first", "second", "third")
WIDTHS = (0.5, 0.9, 0.95)
LENGTH = NutsLength(warmup=WarmUp(300), max_blocks=2)


def drawn(rng: np.random.Generator, manoeuvres: int) -> tuple[dict[str, np.ndarray], Hierarchy]:
    """True values from their priors, and the density of estimates of them."""
    k = len(NAMES)
    aircraft, scatter = rng.standard_normal(k), SCATTER * np.abs(rng.standard_normal(k))
    flown = aircraft + scatter * rng.standard_normal((manoeuvres, k))
    size = 10.0 ** rng.uniform(-2.0, -0.3, (manoeuvres, k))  # standard errors in units of the priors
    mixed = size[..., None] * (np.eye(k) + 0.7 * rng.standard_normal((manoeuvres, k, k)))
    estimate = flown + (mixed @ rng.standard_normal((manoeuvres, k, 1)))[..., 0]
    information = np.linalg.inv(mixed @ np.swapaxes(mixed, 1, 2))
    rest = np.linalg.inv(information[-1])[1:, 1:]  # the last manoeuvre says nothing of the first parameter
    information[-1] = 0.0
    information[-1, 1:, 1:] = np.linalg.inv(rest)
    following = aircraft + scatter * rng.standard_normal(k)
    truth = {"aircraft": aircraft, "scatter": scatter, "first manoeuvre": flown[0], "next flight": following}
    return truth, Hierarchy.of(NAMES, estimate, information)


def ranks(replicates: int, manoeuvres: int) -> None:
    """Simulation-based calibration."""
    rng, began = np.random.default_rng([7, manoeuvres]), time.perf_counter()
    found: dict[str, list[np.ndarray]] = {}
    inside, unsure, narrowed = np.zeros(len(WIDTHS)), 0, []
    for number in range(replicates):
        truth, density = drawn(rng, manoeuvres)
        draws, sampled = pool(density, seed=number, length=LENGTH)
        parts = (draws.aircraft, draws.scatter, draws.manoeuvres[:, :, 0], draws.following)
        flat = {what: x.reshape(-1, len(NAMES)) for what, x in zip(truth, parts, strict=True)}
        for what, x in flat.items():
            found.setdefault(what, []).append(rank(truth[what], x))
        ends = [np.quantile(flat["next flight"], [0.5 - w / 2, 0.5 + w / 2], axis=0) for w in WIDTHS]
        inside += [np.sum((truth["next flight"] > low) & (truth["next flight"] < high)) for low, high in ends]
        unsure += sampled.status.name != "CONVERGED"
        narrowed.append([m.sd / (SCATTER * np.sqrt(1.0 - 2.0 / np.pi)) for m in sampled.marginals.values()])
    total = replicates * len(NAMES)
    print(f"{manoeuvres} manoeuvres, {replicates} replicates of {len(NAMES)} parameters: ", end="")
    print(f"{time.perf_counter() - began:.0f} s, {unsure} not converged")
    for what, one in found.items():
        bands = [band_of([int(r[i]) for r in one]) for i in range(len(NAMES))]
        said = ", ".join("inside" if band.inside else "OUTSIDE" for band in bands)
        print(f"  ranks of {what}: {said} (largest difference {max(np.abs(b.difference).max() for b in bands):.3f})")
    shares = ", ".join(f"{w:.0%}: {n / total:.1%}" for w, n in zip(WIDTHS, inside, strict=True))
    print(f"  next flight inside its intervals: {shares} of {total}")
    print(f"  standard deviation of the scatter over its prior's, median: {np.median(narrowed):.2f}", flush=True)


def main() -> None:
    """Run the part that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("ranks", "flights", "density"))
    parser.add_argument("--replicates", type=int, default=500)
    parser.add_argument("--aircraft", type=int, default=40)
    parser.add_argument("--manoeuvres", type=int, nargs="+")
    given = parser.parse_args()
    if given.part == "ranks":
        for manoeuvres in given.manoeuvres or (2, 9):
            ranks(given.replicates, manoeuvres)
    elif given.part == "flights":
        fly_again(given.aircraft, (given.manoeuvres or [4])[0])
    else:
        compare((given.manoeuvres or [3])[0])


if __name__ == "__main__":
    main()
