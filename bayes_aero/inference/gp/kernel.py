"""The seed paper's kernel ("DPSE"), its eleven hyperparameters and their scaling.

k(x, x') = s0^2 + sum_i s_i^2 x_i x_i' + sf^2 exp(-1/2 sum_i (x_i - x_i')^2 / l_i^2) + sn^2 delta      (Eq. 3-5)

theta = log [s0, s_1..s_d, sf, l_1..l_d, sn], 2d + 3 numbers, in scaled units: inputs minus training mean over
training sd, output over training rms but not centred, because the prior mean is zero and s0 carries the offset.

Caveat, true of every number this package prints from a GP: sn is *white* noise, while the residuals of 25 Hz
flight data have a lag-1 correlation up to 0.98. The GP then takes correlated error for signal in its inputs
(length scales too short), its intervals are too narrow for a new manoeuvre, and a random split, which leaks
neighbours, hides both. Judge it on the manoeuvre split.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.errors import InputError

__all__ = ["Scaling", "hyper_names", "length_slice", "noise_to_signal", "scaled_distance_kernel"]


def length_slice(d: int) -> slice:
    """Positions of the d log length scales in theta."""
    return slice(d + 2, 2 * d + 2)


def hyper_names(input_names: tuple[str, ...]) -> list[str]:
    """Flat names in the order of theta, for labels and messages."""
    linear = [f"linear[{name}]" for name in input_names]
    length = [f"length_scale[{name}]" for name in input_names]
    return ["constant", *linear, "signal", *length, "noise"]


def noise_to_signal(theta: Float[np.ndarray, " p"]) -> Float[np.ndarray, " u"]:
    """u = (log l_1..d, log g), g = sn^2/sf^2: the only directions in which an n x n factorisation is needed."""
    d = (theta.size - 3) // 2
    return np.append(theta[length_slice(d)], 2 * (theta[-1] - theta[d + 1]))


def scaled_distance_kernel(a: Float[np.ndarray, "n d"], b: Float[np.ndarray, "m d"]) -> Float[np.ndarray, "n m"]:
    """exp(-1/2 |a - b|^2) for inputs already divided by their length scales; one n x m array, worked in place.

    |a - b|^2 is expanded, a.b - a.a/2 - b.b/2; rounding can leave it barely positive, hence the clip at zero.
    """
    e = a @ b.T
    e -= 0.5 * np.einsum("ij,ij->i", a, a)[:, None]
    e -= 0.5 * np.einsum("ij,ij->i", b, b)
    np.minimum(e, 0.0, out=e)
    # exp(-300) = 1e-130 is zero beside the diagonal of 1, but far smaller numbers are subnormal, which are slow.
    np.maximum(e, -300.0, out=e)
    return np.exp(e, out=e)


@dataclass(frozen=True, eq=False)
class Scaling:
    """Training mean (d,) and sd (d,) of the inputs, rms of the output: conversion to scaled units and back."""

    mean: Float[np.ndarray, " d"]
    sd: Float[np.ndarray, " d"]
    rms: float

    @classmethod
    def of(cls, X: Float[np.ndarray, "n d"], y: Float[np.ndarray, " n"], names: tuple[str, ...]) -> "Scaling":
        """Scaling of training inputs (n, d) and output (n,); a constant input or a zero output is refused."""
        mean, sd, rms = X.mean(axis=0), X.std(axis=0), float(np.sqrt(np.mean(y**2)))
        flat = sd <= 1e-12 * (np.abs(mean) + np.max(np.abs(X), axis=0))
        if np.any(flat):
            which = ", ".join(n for n, f in zip(names, flat, strict=True) if f)
            raise InputError(f"Input {which} does not vary over the training samples; leave it out of the GP.")
        if not rms > 0:
            raise InputError("The output is zero at every training sample; there is nothing to model.")
        return cls(mean, sd, rms)

    def inputs(self, X: Float[np.ndarray, "n d"]) -> Float[np.ndarray, "n d"]:
        """Physical inputs to scaled ones."""
        return (X - self.mean) / self.sd

    def physical(self, theta: Float[np.ndarray, "*draws p"]) -> dict[str, np.ndarray]:
        """Hyperparameters in physical units, from log scaled theta (..., 2d + 3).

        `constant`, `signal`, `noise`: unit of the output. `linear` (..., d): sd of the slope about the training
        mean, output unit per input unit. `length_scale` (..., d): unit of the input.
        """
        d, x = self.sd.size, np.exp(theta)
        return {
            "constant": np.asarray(x[..., 0] * self.rms),
            "linear": x[..., 1 : d + 1] * self.rms / self.sd,
            "signal": np.asarray(x[..., d + 1] * self.rms),
            "length_scale": x[..., length_slice(d)] * self.sd,
            "noise": np.asarray(x[..., -1] * self.rms),
        }
