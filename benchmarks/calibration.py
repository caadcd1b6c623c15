"""Simulation-based calibration: ranks of the truth among posterior draws, over data drawn from the prior.

    python benchmarks/calibration.py emcee 300 --out calibration      # stall posterior, AR(1) noise
    python benchmarks/calibration.py NUTS 300 --out calibration
    python benchmarks/calibration.py gp 300 --out calibration         # hyperparameters of a Gaussian process
    python benchmarks/calibration.py report --out calibration         # tables and figures of what is there

Every replicate is one line of OUT/<what>.jsonl; a study that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path

import numpy as np
from calibration_figures import rank_bands
from calibration_study import Replicate, calibration_table, process_replicate, stall_replicate
from ranks import band_of

from bayes_aero.flight.card.card import read_card
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.report.style import save
from bayes_aero.simulate.demo import simulate_stall

EVERY = 16  # samples of the demo's two manoeuvres: 282 at 1.6 Hz, so that the prior matters beside the data
INPUTS, SAMPLES = ("alpha", "elevator"), 80  # of the Gaussian process
STUDIES = ("emcee", "NUTS", "gp")


def study(what: str, count: int, out: Path, first: int) -> None:
    """Replicates of the seeds that are not in the file yet."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{what}.jsonl"
    done = {r.seed for r in read(path)}
    card = read_card("attas")
    model = Model.from_card(card)
    observations = observe([simulate_stall(i, card=card) for i in range(2)], card, model)
    thinned = observations.thinned(EVERY)
    x = np.stack([np.asarray(observations.signals[name]) for name in INPUTS], axis=1)
    x = x[np.linspace(0, len(x) - 1, SAMPLES).astype(int)]
    x = (x - x.mean(axis=0)) / x.std(axis=0)
    with path.open("a") as file:
        for seed in range(first, first + count):
            if seed in done:
                continue
            found = process_replicate(x, INPUTS, seed) if what == "gp" else stall_replicate(model, thinned, what, seed)
            file.write(json.dumps(asdict(found)) + "\n")
            file.flush()


def read(path: Path) -> list[Replicate]:
    return [Replicate(**json.loads(line)) for line in path.read_text().splitlines()] if path.exists() else []


def report(out: Path) -> None:
    """Tables, and a figure each, of the replicates so far."""
    for what in STUDIES:
        found = read(out / f"{what}.jsonl")
        if not found:
            continue
        print(f"\n{what}: {len(found)} replicates; {dict(Counter(r.status for r in found))}")
        table = calibration_table(found)
        print(table.to_string(float_format=lambda v: f"{v:.3f}"))
        outside = int((~table["inside band"].astype(bool)).sum())
        print(f"outside the 95 % band: {outside} of {len(table)}; by chance alone {0.05 * len(table):.1f} are expected")
        bands = {name: band_of([r.ranks[name] for r in found]) for name in found[0].ranks}
        print("figure:", save(rank_bands(bands), out / f"{what}.png"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=(*STUDIES, "report"))
    parser.add_argument("count", type=int, nargs="?", default=300)
    parser.add_argument("--out", type=Path, default=Path("calibration"))
    parser.add_argument("--first", type=int, default=0, help="first seed")
    given = parser.parse_args()
    if given.what == "report":
        report(given.out)
    else:
        study(given.what, given.count, given.out, given.first)
