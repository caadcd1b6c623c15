"""How often calibrated one-step predictions are said not to be, for innovations whose neighbours are correlated.

    python benchmarks/one_step_rates.py [--records 300]

Innovations are drawn as first-order autoregressions of unit variance. `not calibrated` counts records with that status;
`shares` counts outputs, and all together, whose shares are said to depart from their probabilities.
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy.signal import lfilter

from bayes_aero.dynamics.kalman import Filtered
from bayes_aero.inference.results import Calibration
from bayes_aero.inference.validation import one_step

CASES = [(n, c, rho) for n, c in ((200, 3), (600, 1), (600, 7), (3000, 3)) for rho in (0.0, 0.15, 0.86)]
APART = (Calibration.TOO_NARROW, Calibration.TOO_WIDE, Calibration.NOT_NORMAL)
SETTLED = 200  # samples until a series no longer knows its begin


def predicted(rng: np.random.Generator, n: int, outputs: int, rho: float):
    """One record of `n` samples, by a filter that predicts variance 1."""
    white = rng.standard_normal((1, n + SETTLED, outputs))
    z = lfilter([np.sqrt(1.0 - rho**2)], [1.0, -rho], white, axis=1)[:, SETTLED:]
    state, matrix = np.zeros((1, n, 1)), np.zeros((1, n, 1, 1))
    found = Filtered(state, matrix, state, matrix, matrix, z, np.ones_like(z), np.ones(z.shape, bool))
    return one_step(found, z, [f"y{c}" for c in range(outputs)])


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--records", type=int, default=300)
    records = parser.parse_args().records
    rng = np.random.default_rng(0)
    print("| samples | outputs | correlation | not calibrated | shares |\n|---|---|---|---|---|")
    for n, outputs, rho in CASES:
        found = [predicted(rng, n, outputs, rho) for _ in range(records)]
        wrong = np.mean([one.status == "not_calibrated" for one in found])
        apart = np.mean([p.calibration in APART for one in found for p in (*one.outputs.values(), one.together)])
        print(f"| {n} | {outputs} | {rho} | {wrong:.1%} | {apart:.1%} |", flush=True)


if __name__ == "__main__":
    main()
