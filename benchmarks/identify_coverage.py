"""How often the intervals of `identify` hold the truth: pairs of simulated stalls, flown and recorded sensor by sensor.

    python benchmarks/identify_coverage.py run 100 --out coverage_identify     # goes on where it stopped
    python benchmarks/identify_coverage.py report --out coverage_identify      # table of what is there

A pair is two stalls of 90 s with the demo's 14 parameters as truth: the demo's own recipe, or random stalls of
`bayes-aero simulate`, with sensor noise alone (white) or with coloured disturbances besides (ar1), at 25 or 50 Hz. Each
is fitted as `identify` fits it: maximum likelihood with corrected bounds, then the posterior by emcee under `--noise`.
Kinds take turns, so that a study that is stopped early has as many of each. `--forming published` studies the published
way.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from pathlib import Path

import numpy as np

from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.likelihood.noise_bias import without_noise_bias
from bayes_aero.inference.posterior.ensemble import EnsembleLength, sample_ensemble
from bayes_aero.inference.posterior.laplace import density_start, find_mode
from bayes_aero.model.density import Density
from bayes_aero.model.model import Model
from bayes_aero.model.noise import DEFAULT, Colour, Noise
from bayes_aero.model.observations import Forming, observe
from bayes_aero.simulate.demo import TRUTH, simulate_stall
from bayes_aero.simulate.request import Request
from bayes_aero.simulate.synthetic_record import synthetic

KINDS = (("white", 0.04), ("white", 0.02), ("ar1", 0.04), ("ar1", 0.02), ("demo", 0.04))
METHODS = ("corrected bound", "posterior")
FIRST = 910_000  # of the seeds, apart from those on which the method was made
Z95 = 1.959963984540054


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


def case(number: int, forming: Forming = Forming.MATCHED, noise: Colour = DEFAULT, sample: bool = True) -> dict:
    """One pair, fitted: estimates, and the ends of every parameter's interval by method."""
    began, (kind, dt) = time.perf_counter(), KINDS[number % len(KINDS)]
    card = read_card("attas")
    model, records = Model.from_card(card), pair(kind, dt, number)
    observations = observe(records, card, model, forming)
    mle = fit_mle(model, observations, seed=0)
    if forming is Forming.MATCHED:
        mle = without_noise_bias(mle, records, card, model)
    sd = mle.crb_corrected
    ends = {METHODS[0]: np.stack([mle.estimate - Z95 * sd, mle.estimate + Z95 * sd], axis=1).tolist()}
    status = ""
    if sample:
        density = Density.of(observations, model, Noise(noise), mle.bias)
        mode = find_mode(density, density_start(density, mle))
        posterior = sample_ensemble(density, mode, seed=number, length=EnsembleLength(2, 1000), predictive=False)
        ends[METHODS[1]] = [list(posterior.marginals[name].ci95) for name in model.names]
        status = posterior.status.name
    row = {"kind": kind, "dt": dt, "names": model.names, "estimate": mle.estimate.tolist(), "ends": ends}
    return row | {"mle": mle.status.name, "posterior": status, "seconds": time.perf_counter() - began}


def run(count: int, out: Path, forming: Forming, noise: Colour, sample: bool) -> None:
    """Pairs until there are `count`, a line of pairs.jsonl each: errors and interval ends by method."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "pairs.jsonl"
    done = len(path.read_text().splitlines()) if path.exists() else 0
    for number in range(done, count):
        row = case(number, forming, noise, sample)
        with path.open("a") as file:
            file.write(json.dumps(row) + "\n")


def report(out: Path) -> None:
    """Shares of the truths inside, by kind and by parameter, with their standard errors over pairs."""
    rows = [json.loads(line) for line in (out / "pairs.jsonl").read_text().splitlines()]
    truth = np.array([TRUTH[name] for name in rows[0]["names"]])
    print(f"{len(rows)} pairs")
    for method in METHODS:
        having = [row for row in rows if method in row["ends"]]
        if not having:
            continue
        ends = np.array([row["ends"][method] for row in having])
        inside = (ends[..., 0] <= truth) & (truth <= ends[..., 1])
        each = inside.mean(axis=1)
        error = each.std(ddof=1) / np.sqrt(len(each))
        print(f"\n{method}: {len(having)} pairs, {inside.mean():.3f} +- {error:.3f}")
        if method == METHODS[1]:
            print(
                "  status: "
                + ", ".join(f"{n} {name.lower()}" for name, n in Counter(r["posterior"] for r in having).items())
            )
        for kind, dt in KINDS:
            here = np.array([row["kind"] == kind and row["dt"] == dt for row in having])
            if here.any():
                print(f"  {kind:5} {1 / dt:g} Hz: {inside[here].mean():.3f} ({here.sum()} pairs)")
        print("  " + ", ".join(f"{n} {x:.2f}" for n, x in zip(rows[0]["names"], inside.mean(axis=0), strict=True)))
    worst = np.median([np.array(row["estimate"]) - truth for row in rows], axis=0) / np.abs(truth)
    print("\nmedian error: " + ", ".join(f"{n} {x:+.2%}" for n, x in zip(rows[0]["names"], worst, strict=True)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "report"))
    parser.add_argument("count", type=int, nargs="?", default=100)
    parser.add_argument("--out", type=Path, default=Path("coverage_identify"))
    parser.add_argument("--forming", type=Forming, choices=list(Forming), default=Forming.MATCHED)
    parser.add_argument("--noise", type=Colour, choices=list(Colour), default=DEFAULT, help="Of the posterior.")
    parser.add_argument("--no-posterior", dest="sample", action="store_false", help="Corrected bounds alone.")
    given = parser.parse_args()
    if given.what == "report":
        report(given.out)
    else:
        run(given.count, given.out, given.forming, given.noise, given.sample)
