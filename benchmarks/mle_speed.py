"""Gauss-Newton fit of the stall model against scipy.optimize.least_squares on the same model in NumPy, in one run.

    python benchmarks/mle_speed.py [RECORD ...] [--repeats 15]

Without a record the simulated manoeuvres are fitted. Both start from the card. least_squares gets the residual
covariance of the optimum as weights, which our fit has to find, and then has the same optimum; it runs with its default
finite differences, once as `trf` with x_scale='jac' and once as MINPACK's `lm`. Compilation comes before the clock.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from reference import Reference, agree, load
from scipy.optimize import least_squares

from bayes_aero.inference.likelihood.mle import descend, fit_mle
from bayes_aero.inference.likelihood.mle_result import MleStatus

SAME_OPTIMUM = 1e-2  # Cramer-Rao deviations: how near both must end
SOLVERS = {"trf": {"method": "trf", "x_scale": "jac"}, "lm": {"method": "lm", "x_scale": "jac"}}


def main():
    """Print times, ratios and how far the optima are apart."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("records", nargs="*", type=Path)
    parser.add_argument("--repeats", type=int, default=15)
    options = parser.parse_args()
    _, model, observations = load(options.records)
    reference = Reference(observations, model.names)
    start = np.array([p.start for p in model.free])

    best = fit_mle(model, observations, extra_starts=0)  # compiles, too
    assert best.status is MleStatus.CONVERGED, best.status
    for theta in (start, best.estimate):
        same = agree(
            np.asarray(model.predicted(theta, observations.signals, observations.aircraft)).T, reference(theta)
        )
    weight = 1.0 / np.sqrt(best.R)[:, None]

    def residual(theta):
        return (weight * (reference.measured - reference(theta))).ravel()

    runs = {
        "bayes_aero, fit": lambda: descend(model, observations, start).theta,
        "bayes_aero, fit and both bounds": lambda: fit_mle(model, observations, extra_starts=0).estimate,
    }
    runs |= {f"least_squares, {k}": lambda o=o: least_squares(residual, start, **o).x for k, o in SOLVERS.items()}
    times = {name: [] for name in runs}
    for _ in range(options.repeats):  # in turn, so that a slow moment of the machine falls on all
        for name, fit in runs.items():
            began = time.perf_counter()
            found = fit()
            times[name].append(time.perf_counter() - began)
            apart = np.max(np.abs(found - best.estimate) / best.crb)
            assert apart < SAME_OPTIMUM, f"{name} ended {apart:.2g} Cramer-Rao deviations away"
    print(f"n = {observations.n}, {len(start)} parameters, models {same:.0e} apart, {options.repeats} repeats, medians")
    ours = np.array(times["bayes_aero, fit"])
    for name, taken in times.items():
        ratio = np.median(np.array(taken) / ours)
        print(f"  {name:32s} {1e3 * np.median(taken):8.1f} ms  {ratio:6.1f} x our fit")


if __name__ == "__main__":
    main()
