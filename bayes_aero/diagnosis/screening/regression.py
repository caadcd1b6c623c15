"""Regression of residuals on sensitivities from inner products alone, so that thousands of fits cost seconds.

Estimation is the published one: independent residuals, one variance per output, re-estimated (cost det R). Its
uncertainty is not: `screening.uncertainty` gives the covariance that coloured residuals leave it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

ROUNDS = 5  # alternations between parameters and variances


@dataclass(frozen=True)
class RegressionFit:
    """k active columns, c outputs: the step from the linearisation point and the outputs' variances."""

    columns: Int[np.ndarray, " k"]
    step: Float[np.ndarray, " k"]
    normal: Float[np.ndarray, "k k"]
    variance: Float[np.ndarray, " c"]
    deviance: float  # sum over outputs of n log(variance), plus the prior's quadratic form

    def places(self, columns: Sequence | np.ndarray) -> list[int]:
        """Where each of these columns stands among the active ones."""
        return [int(np.flatnonzero(self.columns == column)[0]) for column in columns]


@dataclass(frozen=True)
class Products:
    """Inner products of [residual, sensitivities] by fold and output: (f, c, K+1, K+1), and samples per fold (f,)."""

    gram: Float[np.ndarray, "f c k k"]
    count: Int[np.ndarray, " f"]

    @classmethod
    def of(cls, residual: Float[np.ndarray, "m c"], S: Float[np.ndarray, "m c k"], folds: Sequence[slice]) -> Products:
        """Each fold is a contiguous stretch of blocks."""
        data = np.moveaxis(np.concatenate([residual[:, :, None], S], axis=2), 1, 0)
        gram = np.stack([data[:, fold].transpose(0, 2, 1) @ data[:, fold] for fold in folds])
        return cls(gram, np.array([fold.stop - fold.start for fold in folds]))

    def over(self, folds: Sequence[int]) -> Products:
        """The chosen folds summed into one."""
        chosen = list(folds)
        return Products(self.gram[chosen].sum(axis=0, keepdims=True), self.count[chosen].sum(keepdims=True))

    def without(self, fold: int) -> Products:
        """All folds but one summed into one."""
        return self.over([f for f in range(len(self.count)) if f != fold])

    def only(self, columns: Int[np.ndarray, " k"]) -> Products:
        """These columns alone, numbered anew in their order."""
        at = np.append(0, np.asarray(columns) + 1)
        return Products(self.gram[:, :, at[:, None], at[None, :]], self.count)

    @cached_property
    def total(self) -> Float[np.ndarray, "c k k"]:
        """Inner products summed over folds."""
        return self.gram.sum(axis=0)

    def shifted(self, columns: Int[np.ndarray, " k"], by: Float[np.ndarray, " k"]) -> Products:
        """The same after a step `by` in `columns`: the residual becomes residual - S by."""
        gram, at = self.gram.copy(), np.asarray(columns) + 1
        gram[..., 0, :] -= np.einsum("fckl,k->fcl", gram[..., at, :], by)
        gram[..., :, 0] -= np.einsum("fckl,l->fck", gram[..., :, at], by)
        return Products(gram, self.count)

    def fit_many(
        self,
        columns: Int[np.ndarray, "j k"],
        mean: Float[np.ndarray, " K"],
        precision: Float[np.ndarray, " K"],
        held: Float[np.ndarray, " c"] | None = None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Fit j sets of columns at once, each with the normal prior (`mean`, `precision`) of its steps.

        Variances are found with the steps, unless they are `held`.

        Returns steps (j, k), information matrices (j, k, k), variances (j, c) and deviances (j,)."""
        gram, n = self.total, float(self.count.sum())
        j, k = columns.shape
        full = np.concatenate([np.zeros((j, 1), int), columns + 1], axis=1)
        part = np.moveaxis(gram[:, full[:, :, None], full[:, None, :]], 0, 1)  # j c k+1 k+1
        least = np.maximum(ROUNDING * part[:, :, 0, 0] / n, TINY)  # records without noise leave less than rounding does
        own, centre = precision[columns], mean[columns]

        def stepped(information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Step and normal matrix for (j, k+1, k+1) products of samples that are divided by their deviations."""
            normal = information[:, 1:, 1:] + np.eye(k) * own[:, None, :]
            scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), TINY))
            scaled = normal * scale[:, :, None] * scale[:, None, :] + RIDGE * np.eye(k)
            right = (information[:, 1:, 0] + own * centre) * scale
            return scale * np.linalg.solve(scaled, right[:, :, None])[:, :, 0], normal

        def variance_of(step: np.ndarray) -> np.ndarray:
            """Mean squares (j, c) that a step of all outputs (j, 1, k), or one of each (j, c, k), leaves."""
            v = np.concatenate([np.ones((*step.shape[:2], 1)), -step], axis=2)
            return np.maximum((v[:, :, None, :] @ (part @ v[:, :, :, None]))[:, :, 0, 0] / n, least)

        def settled(variance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
            for _ in range(ROUNDS if held is None else 1):
                step, normal = stepped(np.einsum("jc,jckl->jkl", 1.0 / variance, part))
                variance = variance_of(step[:, None, :]) if held is None else variance
            deviance = n * np.log(variance).sum(axis=1) + np.sum(own * (step - centre) ** 2, axis=1)
            return step, normal, variance, deviance

        if held is not None:
            return settled(np.tile(held, (j, 1)))
        # Where a form is wrong, the variances may settle with one output given up for another. So they begin as what is
        # there, and as what each output alone can be fitted to.
        begin = np.maximum(part[:, :, 0, 0] / n, TINY)
        alone = [stepped(part[:, c] / begin[:, c, None, None])[0] for c in range(part.shape[1])]
        first, second = settled(begin), settled(variance_of(np.stack(alone, axis=1)))
        better = second[3] < first[3]
        step, normal, variance, deviance = (
            np.where(better.reshape(-1, *[1] * (x.ndim - 1)), y, x) for x, y in zip(first, second, strict=True)
        )
        return step, normal, variance, deviance

    def fit(
        self,
        columns: Int[np.ndarray, " k"],
        mean: np.ndarray,
        precision: np.ndarray,
        held: Float[np.ndarray, " c"] | None = None,
    ) -> RegressionFit:
        """One set of columns."""
        step, normal, variance, deviance = self.fit_many(columns[None], mean, precision, held)
        return RegressionFit(columns, step[0], normal[0], variance[0], float(deviance[0]))


def partialled(
    X: Float[np.ndarray, "m c j"], B: Float[np.ndarray, "m c b"], weight: Float[np.ndarray, " c"]
) -> Float[np.ndarray, "m c j"]:
    """What weighted least squares on the columns `B` leaves of each of the columns `X`."""
    cross, own = (np.einsum("mci,c,mcj->ij", B, weight, other, optimize=True) for other in (X, B))
    return X - B @ (inverse(own) @ cross)


TINY = 1e-300
NOTHING = 1e-130  # least information that is inverted: a covariance of it, and its square, are still numbers
ROUNDING = 1e-14  # of a sum of squares, of what is left of it
RIDGE = 1e-11  # relative to the information's unit diagonal: keeps collinear columns finite, far below any noise


def inverse(matrix: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """Inverse of a symmetric positive matrix whose scales differ by many orders."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), NOTHING))
    return np.linalg.inv(matrix * np.outer(scale, scale) + RIDGE * np.eye(len(matrix))) * np.outer(scale, scale)
