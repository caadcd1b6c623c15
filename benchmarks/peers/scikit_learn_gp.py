"""The paper's kernel in scikit-learn, for the benchmarks that race against it."""

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


def from_scikit_learn(log_theirs):
    """Ours (logs of sds, lengths) of theirs (logs of variances, lengths); the order is the same."""
    factor = np.full(log_theirs.size, 2.0)
    factor[(log_theirs.size - 3) // 2 + 2 : -1] = 1.0
    return log_theirs / factor


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
