"""From what was flown to what a faulty installation would have recorded: effects of stage CHANNEL run backwards."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.sparse.linalg import LinearOperator, lsmr

from bayes_aero.flight.aircraft import Aircraft
from bayes_aero.model.model import Model

STEPS = 8
TOLERANCE = 1e-11  # of a channel's largest value


class _Correction(eqx.Module):
    """`Model.corrected` as a function of one matrix, a channel a row, each over its own scale."""

    model: Model = eqx.field(static=True)
    names: tuple[str, ...] = eqx.field(static=True)
    values: dict[str, Any]
    marks: dict[str, Any]
    aircraft: Aircraft
    scale: Float[Array, " k"]

    @eqx.filter_jit
    def __call__(self, x: Float[Array, "k n"]) -> Float[Array, "k n"]:
        channels = dict(zip(self.names, x * self.scale[:, None], strict=True))
        true = self.model.corrected(self.values, channels | self.marks, self.aircraft)
        return jnp.stack([true[name] for name in self.names]) / self.scale[:, None]

    @eqx.filter_jit
    def forward(self, x: Float[Array, "k n"], change: Float[Array, "k n"]) -> Float[Array, "k n"]:
        """Derivative at `x` times `change`."""
        return jax.jvp(self, (x,), (change,))[1]

    @eqx.filter_jit
    def backward(self, x: Float[Array, "k n"], weight: Float[Array, "k n"]) -> Float[Array, "k n"]:
        """Transposed derivative at `x` times `weight`."""
        return jax.vjp(self, x)[1](weight)[0]


class _Derivative(LinearOperator):
    """The derivative at `x`, on vectors."""

    def __init__(self, correction: _Correction, x: Float[Array, "k n"]) -> None:
        super().__init__(np.float64, (x.size, x.size))
        self.correction, self.x = correction, x

    def _matvec(self, v: np.ndarray) -> np.ndarray:
        return np.asarray(self.correction.forward(self.x, jnp.asarray(v.reshape(self.x.shape)))).ravel()

    def _rmatvec(self, v: np.ndarray) -> np.ndarray:
        return np.asarray(self.correction.backward(self.x, jnp.asarray(v.reshape(self.x.shape)))).ravel()


def corrected(
    model: Model,
    values: Mapping[str, Any],
    channels: Mapping[str, np.ndarray],
    marks: Mapping[str, Any],
    aircraft: Aircraft,
) -> dict[str, np.ndarray]:
    """`Model.corrected`, compiled, without the marks."""
    correction, x = _correction(model, values, channels, marks, aircraft)
    return dict(zip(channels, np.asarray(correction(x) * correction.scale[:, None]), strict=True))


def misrecorded(
    model: Model,
    values: Mapping[str, Any],
    true: Mapping[str, np.ndarray],
    marks: Mapping[str, Any],
    aircraft: Aircraft,
) -> dict[str, np.ndarray]:
    """Channels that `Model.corrected` turns into `true`.

    Gauss-Newton steps from the true channels, each solved for the least change (LSMR: Fong and Saunders, SIAM J. Sci.
    Comput. 33 (2011) 2950). A plain fixed-point iteration would blow up what a delay leaves near half the sampling
    rate, where it cannot be undone.
    """
    correction, goal = _correction(model, values, true, marks, aircraft)
    x, left = goal, 0.0
    for _ in range(STEPS):
        error = np.asarray(goal - correction(x))
        # What LSMR could not solve another step cannot either: it is what a delay has lost. Curvature leaves more.
        if np.max(np.abs(error)) < TOLERANCE or np.linalg.norm(error) < 2.0 * left:
            break
        error = np.where(np.abs(error) < 1e-14, 0.0, error)  # rounding, in channels that no effect touches
        step, _, _, left, *_ = lsmr(
            _Derivative(correction, x), error.ravel(), atol=1e-13, btol=1e-13, conlim=0.0, maxiter=300
        )
        x = x + jnp.asarray(step.reshape(x.shape))
    change = np.asarray((x - goal) * correction.scale[:, None])
    return {name: series + dx for (name, series), dx in zip(true.items(), change, strict=True)}


def _correction(
    model: Model,
    values: Mapping[str, Any],
    channels: Mapping[str, np.ndarray],
    marks: Mapping[str, Any],
    aircraft: Aircraft,
) -> tuple[_Correction, Float[Array, "k n"]]:
    x = np.stack(list(channels.values()))
    scale = np.maximum(np.max(np.abs(x), axis=1), 1e-3)
    correction = _Correction(model, tuple(channels), dict(values), dict(marks), aircraft, jnp.asarray(scale))
    return correction, jnp.asarray(x / scale[:, None])
