"""How often 95 % intervals hold the truth, against the colour of the noise and the sample rate.

    python benchmarks/coverage.py run 100 --out coverage        # every cell in turn; goes on where it stopped
    python benchmarks/coverage.py report --out coverage         # table and figure of what is there

A cell is a rate and a colour: the demo's two manoeuvres, 14 parameters, coefficients simulated at the demo's truth with
AR(1) noise of the same standard deviation and of lag-1 correlation rho *at that rate*. Cells are done in rounds of
`ROUND` replicates, so that a study that is stopped early has some of each.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from coverage_figures import coverage_against_colour
from coverage_study import METHODS, coverage_study

from bayes_aero.flight.card.card import read_card
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.report.style import save
from bayes_aero.simulate.demo import TRUTH, simulate_stall

STEPS = (4, 16)  # of 25 Hz: 6.25 and 1.5625 samples a second
RHOS = (0.0, 0.5, 0.9, 0.98)
SIGMA = {"sigma_CL": 0.02, "sigma_CD": 0.005, "sigma_Cm": 0.004}
ROUND = 10


def run(count: int, out: Path, only: int | None) -> None:
    """Rounds of replicates of every cell until each has `count`; `only` takes one of the rates."""
    out.mkdir(parents=True, exist_ok=True)
    card = read_card("attas")
    model = Model.from_card(card)
    records = [simulate_stall(i, card=card, sensor_noise=0.0, disturbance=0.0) for i in range(2)]
    clean = observe(records, card, model)
    for number in range(-(-count // ROUND)):
        for step in STEPS if only is None else (only,):
            for rho in RHOS:
                path = out / f"step{step}_rho{rho:g}_round{number}.json"
                if path.exists():
                    continue
                noise = SIGMA | {f"rho_{name}": rho for name in ("CL", "CD", "Cm")}
                found = coverage_study(
                    model,
                    clean.thinned(step),
                    TRUTH,
                    noise,
                    replicates=ROUND,
                    seed=1000 * number + step,
                    max_steps=1000,
                )
                inside = dict(zip(METHODS, found.inside.mean(axis=2).tolist(), strict=True))  # a share a replicate
                row = {"step": step, "rho": rho, "inside": inside, "converged": float(found.converged.mean())}
                path.write_text(json.dumps(row))


def report(out: Path) -> None:
    """Share covered in every cell, over parameters and replicates, with its standard error over replicates."""
    rows = [json.loads(path.read_text()) for path in sorted(out.glob("step*.json"))]
    shares: dict[float, dict[str, list[tuple[float, float]]]] = {}
    for step in sorted({row["step"] for row in rows}):
        rate = 25.0 / step
        print(f"\n{rate:g} samples a second")
        for rho in RHOS:
            here = [row for row in rows if row["step"] == step and row["rho"] == rho]
            if not here:
                continue
            cells = []
            for method in METHODS:
                each = np.concatenate([row["inside"][method] for row in here])
                shares.setdefault(rate, {}).setdefault(method, []).append((rho, float(each.mean())))
                cells.append(f"{method} {each.mean():.3f} +- {each.std(ddof=1) / np.sqrt(len(each)):.3f}")
            converged = np.mean([row["converged"] for row in here])
            print(f"  rho {rho:g}, {ROUND * len(here)} replicates ({converged:.0%} converged): {'; '.join(cells)}")
    print("figure:", save(coverage_against_colour(shares), out / "coverage.png"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("run", "report"))
    parser.add_argument("count", type=int, nargs="?", default=100)
    parser.add_argument("--out", type=Path, default=Path("coverage"))
    parser.add_argument("--step", type=int, choices=STEPS, help="one rate only")
    given = parser.parse_args()
    if given.what == "report":
        report(given.out)
    else:
        run(given.count, given.out, given.step)
