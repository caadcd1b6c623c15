"""The paper's kernel in scikit-learn; run as a script, both programs' objective with gradient and MAP in one run.

    python benchmarks/scikit_learn_gp.py [--n 3536]

A simulated stall-like record. The prior is flat on both sides and the output scaled alike, so that values must agree
to 1e-8. scikit-learn comes with the `bench` extra.
"""

import argparse

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, Hyperparameter, Kernel, WhiteKernel


class ArdLinear(Kernel):
    """sum_i v_i x_i x_i'; scikit-learn's DotProduct has one variance for all inputs."""

    def __init__(self, variances, limits=(1e-5, 1e5)):
        self.variances = variances
        self.limits = limits

    @property
    def hyperparameter_variances(self):
        """Declared to scikit-learn, one per input."""
        return Hyperparameter("variances", "numeric", self.limits, len(self.variances))

    def __call__(self, X, Y=None, eval_gradient=False):
        """Covariance, and its derivatives by the logarithms of the variances."""
        other = X if Y is None else Y
        v = np.asarray(self.variances)
        k = (X * v) @ other.T
        if not eval_gradient:
            return k
        return k, np.einsum("ik,jk,k->ijk", X, X, v)

    def diag(self, X):
        """Its diagonal."""
        return X**2 @ np.asarray(self.variances)

    def is_stationary(self):
        """It depends on the inputs themselves."""
        return False


def to_scikit_learn(theta):
    """Ours (logs of sds, lengths) to theirs (logs of variances, lengths); the order is the same."""
    factor = np.full(theta.size, 2.0)
    factor[(theta.size - 3) // 2 + 2 : -1] = 1.0
    return factor * theta


def from_scikit_learn(log_theirs):
    """The inverse of `to_scikit_learn`."""
    return log_theirs / to_scikit_learn(np.ones(log_theirs.size))


def scikit_learn_model(x, y, theta, optimizer=None, limits=(1e-5, 1e5), lengths=(1e-5, 1e5)):
    """scikit-learn's regressor with the DPSE kernel at theta, fitted (with `optimizer`, optimised) on x, y.

    `limits` are those of variances, `lengths` of length scales.
    """
    e = np.exp(theta)
    d = x.shape[1]
    kernel = (
        ConstantKernel(e[0] ** 2, limits)
        + ArdLinear(e[1 : d + 1] ** 2, limits)
        + ConstantKernel(e[d + 1] ** 2, limits) * RBF(e[d + 2 : 2 * d + 2], lengths)
        + WhiteKernel(e[-1] ** 2, limits)
    )
    return GaussianProcessRegressor(kernel, alpha=0.0, optimizer=optimizer).fit(x, y)


START = np.log([1.0, 0.5, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0, 0.1])


def simulated(n, seed=0):
    """Inputs that wander smoothly, a non-linear output and correlated noise, as a record at 25 Hz has them."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(n + 500, 5))
    smooth = np.stack([np.convolve(s, np.hanning(75) / 6.0, mode="same") for s in steps.T])[:, 250 : 250 + n]
    x = smooth[:4].T
    attached = 1.0 + 0.4 * x[:, 0] - 0.3 / (1.0 + np.exp(-6.0 * (x[:, 0] - 0.5)))
    return x, attached + 0.1 * x[:, 1] * x[:, 2] + 0.02 * smooth[4] + 0.02 * rng.normal(size=n)


def main():
    """Print both comparisons."""
    from timing import compare

    from bayes_aero.inference.gp.kernel import Scaling, noise_to_signal
    from bayes_aero.inference.gp.optimum import maximise
    from bayes_aero.inference.gp.priors import Priors
    from bayes_aero.inference.gp.reduced import ReducedData
    from bayes_aero.inference.gp.sampling.density import log_density

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=3536)
    X, y = simulated(parser.parse_args().n)
    scaling, flat = Scaling.of(X, y, tuple("abcd")), Priors.flat()
    x, y = scaling.inputs(X), y / scaling.rms
    data, model = ReducedData.of(x, y), scikit_learn_model(x, y, START)
    theirs = model.log_marginal_likelihood(to_scikit_learn(START))
    print(f"n = {data.n}, values {abs(log_density(START, data, flat).value / theirs - 1):.1e} apart")
    gradient = {
        "bayes_aero, objective and gradient": lambda: log_density(START, data, flat),
        "scikit-learn": lambda: model.log_marginal_likelihood(to_scikit_learn(START), eval_gradient=True),
    }
    climb = {
        "bayes_aero, maximum from one start": lambda: maximise(noise_to_signal(START), data, flat, w=START[:6].copy()),
        "scikit-learn": lambda: scikit_learn_model(x, y, START, optimizer="fmin_l_bfgs_b"),
    }
    compare(gradient, 3)
    compare(climb, 1)


if __name__ == "__main__":
    main()
