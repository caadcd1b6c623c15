"""Gaussian process: objective with gradient, and MAP, against scikit-learn with the same kernel, in one run.

    python benchmarks/gp_speed.py [--n 3536] [--data FILE.npz] [--no-fit]

FILE.npz holds X (n, 4) and y (n,); without it, a simulated stall-like record is used. Needs scikit-learn (the
`bench` extra). The prior is flat on both sides and the output scaled alike, so values must agree to 1e-8.
"""

import argparse
import time

import numpy as np
from scikit_learn_gp import scikit_learn_model, to_scikit_learn

from bayes_aero.inference.gp.kernel import Scaling, noise_to_signal
from bayes_aero.inference.gp.optimum import maximise
from bayes_aero.inference.gp.priors import Priors
from bayes_aero.inference.gp.reduced import ReducedData
from bayes_aero.inference.gp.sampling.density import log_density

START = np.log([1.0, 0.5, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 0.1])


def simulated(n, seed=0):
    """Inputs that wander smoothly, a non-linear output and correlated noise, as a record at 25 Hz has them."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(n + 500, 5))
    smooth = np.stack([np.convolve(s, np.hanning(75) / 6.0, mode="same") for s in steps.T])[:, 250 : 250 + n]
    x = smooth[:4].T
    attached = 1.0 + 0.4 * x[:, 0] - 0.3 / (1.0 + np.exp(-6.0 * (x[:, 0] - 0.5)))
    return x, attached + 0.1 * x[:, 1] * x[:, 2] + 0.02 * smooth[4] + 0.02 * rng.normal(size=n)


def best_of(function, repeats=3):
    """Shortest wall time of `repeats` calls after one to warm up, s, and the last result."""
    function()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - began)
    return min(times), result


def compare_objective(x, y, data):
    """Time value and gradient at the start; returns nothing, prints one row per engine."""
    flat = Priors.flat()
    model = scikit_learn_model(x, y, START)
    theirs, (value, _) = best_of(lambda: model.log_marginal_likelihood(to_scikit_learn(START), eval_gradient=True), 2)
    ours, out = best_of(lambda: log_density(START, data, flat))
    print(f"objective and gradient, n = {data.n}")
    for label, seconds, v in (("scikit-learn", theirs, value), ("bayes_aero", ours, out.value)):
        apart = abs(v / value - 1)
        print(f"  {label:24s} {seconds:8.3f} s  {theirs / seconds:5.1f} x  value {v:.8f}  apart {apart:.1e}")


def compare_map(x, y, data):
    """Time the climb from the same start to the same optimum, flat prior."""
    began = time.perf_counter()
    d = x.shape[1]
    best = maximise(noise_to_signal(START), data, Priors.flat(), w=START[: d + 2].copy())
    ours = time.perf_counter() - began
    began = time.perf_counter()
    model = scikit_learn_model(x, y, START, optimizer="fmin_l_bfgs_b")
    theirs = time.perf_counter() - began
    value = model.log_marginal_likelihood_value_
    print(f"maximum marginal likelihood from one start, n = {data.n}")
    print(f"  {'scikit-learn':24s} {theirs:8.1f} s  {1.0:5.1f} x  value {value:.4f}")
    print(f"  {'bayes_aero':24s} {ours:8.1f} s  {theirs / ours:5.1f} x  value {best.value:.4f}", end="")
    print(f"  ({best.evaluations} evaluations, {best.status.name})")


def main():
    """Print both comparisons."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=3536)
    parser.add_argument("--data")
    parser.add_argument("--no-fit", action="store_true")
    options = parser.parse_args()
    if options.data:
        with np.load(options.data) as stored:
            X, y = stored["X"][: options.n], stored["y"][: options.n]
    else:
        X, y = simulated(options.n)
    scaling = Scaling.of(X, y, tuple("abcd"))
    x, y = scaling.inputs(X), y / scaling.rms
    data = ReducedData.of(x, y)
    compare_objective(x, y, data)
    if not options.no_fit:
        compare_map(x, y, data)


if __name__ == "__main__":
    main()
