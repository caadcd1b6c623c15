"""Regression under autoregressive noise from inner products alone, so that thousands of fits cost seconds.

Residual and sensitivities enter once, as inner products of all columns at all pairs of lags. Whitening by any
autoregression, leaving a fold out, re-estimating the noise and adding a candidate are then algebra on small matrices.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

ORDER = 3  # of the autoregression, at the blocks' rate of about 5 Hz; our choice
ROUNDS = 6  # alternations between parameters and noise; the likelihood changes by less than 1e-3 beyond


@dataclass(frozen=True)
class Fit:
    """Generalised least squares with the noise re-estimated; k columns, c outputs.

    `log_likelihood` is conditional on the first `ORDER` blocks of each stretch and leaves out constants; `penalty` is
    half the prior's quadratic form. `phi` are the autoregression's coefficients, `sigma` the innovations' deviation.
    """

    columns: Int[np.ndarray, " k"]
    step: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    phi: Float[np.ndarray, "c p"]
    sigma: Float[np.ndarray, " c"]
    log_likelihood: float
    penalty: float


@dataclass(frozen=True)
class Lagged:
    """Inner products of [residual, sensitivities] at lags i, j, by fold and output: (f, c, p+1, p+1, K+1, K+1)."""

    gram: Float[np.ndarray, "f c i j k k"]
    count: Int[np.ndarray, " f"]

    @classmethod
    def of(
        cls, residual: Float[np.ndarray, "m c"], S: Float[np.ndarray, "m c k"], folds: Sequence[Sequence[slice]]
    ) -> Lagged:
        """Each fold is a list of contiguous stretches; no product reaches across stretches."""
        data = np.concatenate([residual[:, :, None], S], axis=2)
        _, outputs, K = data.shape
        gram = np.zeros((len(folds), outputs, ORDER + 1, ORDER + 1, K, K))
        count = np.zeros(len(folds), int)
        for f, stretches in enumerate(folds):
            for stretch in stretches:
                part = data[stretch]
                count[f] += len(part) - ORDER
                for c in range(outputs):
                    used = np.flatnonzero(np.any(part[:, c] != 0.0, axis=0))
                    lags = _lags(part[:, c][:, used]).transpose(1, 0, 2)
                    flat = lags.reshape(len(lags), -1)
                    product = (flat.T @ flat).reshape(ORDER + 1, len(used), ORDER + 1, len(used))
                    gram[f, c][:, :, used[:, None], used[None, :]] += product.transpose(0, 2, 1, 3)
        return cls(gram, count)

    def over(self, folds: Sequence[int]) -> Lagged:
        """The chosen folds summed into one."""
        chosen = list(folds)
        return Lagged(self.gram[chosen].sum(axis=0, keepdims=True), self.count[chosen].sum(keepdims=True))

    def shifted(self, columns: Int[np.ndarray, " k"], by: Float[np.ndarray, " k"]) -> Lagged:
        """The same products after a step `by` in `columns`: the residual becomes residual - S by."""
        gram = self.gram.copy()
        at = np.asarray(columns) + 1
        gram[..., 0, :] -= np.einsum("fcijkl,k->fcijl", gram[..., at, :], by)
        gram[..., :, 0] -= np.einsum("fcijkl,l->fcijk", gram[..., :, at], by)
        return Lagged(gram, self.count)

    def fit_many(
        self,
        columns: Int[np.ndarray, "j k"],
        mean: Float[np.ndarray, " K"],
        precision: Float[np.ndarray, " K"],
        rounds: int = ROUNDS,
        phi: Float[np.ndarray, "c p"] | None = None,
    ) -> tuple[np.ndarray, ...]:
        """Fit j sets of columns at once on all folds together.

        `mean` and `precision` are the normal prior of each column's step. Returns step (j, k), precision matrix
        (j, k, k), phi (j, c, p), sigma2 (j, c), log-likelihood (j,), penalty (j,). With `phi` the first whitening uses
        it instead of none.
        """
        gram, n = self.gram.sum(axis=0), int(self.count.sum())
        j, k = columns.shape
        full = np.concatenate([np.zeros((j, 1), int), columns + 1], axis=1)
        part = gram[:, :, :, full[:, :, None], full[:, None, :]]  # c p p j k+1 k+1
        outputs = part.shape[0]
        coefficients = np.zeros((j, outputs, ORDER)) if phi is None else np.broadcast_to(phi, (j, outputs, ORDER))
        weight = None
        prior_mean, prior_precision = mean[columns], precision[columns]
        diagonal = np.eye(k) * prior_precision[:, None, :]
        for _ in range(rounds):
            psi = np.concatenate([np.ones((j, outputs, 1)), -coefficients], axis=2)
            white = np.einsum("jca,jcb,cabjkl->jckl", psi, psi, part, optimize=True)
            if weight is None:
                weight = n / np.maximum(white[:, :, 0, 0], 1e-300)
            normal = np.einsum("jc,jckl->jkl", weight, white)
            matrix = normal[:, 1:, 1:] + diagonal
            scale = 1.0 / np.sqrt(np.maximum(np.diagonal(matrix, axis1=1, axis2=2), 1e-300))
            scaled = matrix * scale[:, :, None] * scale[:, None, :] + 1e-12 * np.eye(k)
            right = (normal[:, 1:, 0] + prior_precision * prior_mean) * scale
            step = scale * np.linalg.solve(scaled, right[:, :, None])[:, :, 0]
            v = np.concatenate([np.ones((j, 1)), -step], axis=1)
            lagged = np.einsum("jk,cabjkl,jl->jcab", v, part, v, optimize=True)
            coefficients = _autoregression(lagged)
            psi = np.concatenate([np.ones((j, outputs, 1)), -coefficients], axis=2)
            sigma2 = np.maximum(np.einsum("jca,jcb,jcab->jc", psi, psi, lagged) / n, 1e-300)
            weight = 1.0 / sigma2
        penalty = 0.5 * np.sum(prior_precision * (step - prior_mean) ** 2, axis=1)
        likelihood = -0.5 * n * np.sum(np.log(sigma2) + 1.0, axis=1)
        return step, matrix, coefficients, sigma2, likelihood, penalty

    def fit(self, columns: Int[np.ndarray, " k"], mean: np.ndarray, precision: np.ndarray) -> Fit:
        """One set of columns."""
        step, matrix, phi, sigma2, likelihood, penalty = self.fit_many(columns[None], mean, precision)
        covariance = inverse(matrix[0])
        return Fit(columns, step[0], covariance, phi[0], np.sqrt(sigma2[0]), float(likelihood[0]), float(penalty[0]))

    def log_density(self, fit: Fit) -> Float[np.ndarray, " f"]:
        """Log-density of each fold under a fit made elsewhere, at its point estimate and with its noise."""
        full = np.concatenate([[0], fit.columns + 1])
        v = np.concatenate([[1.0], -fit.step])
        psi = np.concatenate([np.ones((len(fit.phi), 1)), -fit.phi], axis=1)
        part = self.gram[:, :, :, :, full[:, None], full[None, :]]
        squares = np.einsum("ca,cb,fcabkl,k,l->fc", psi, psi, part, v, v, optimize=True)
        return -0.5 * (squares / fit.sigma**2 + self.count[:, None] * np.log(2 * np.pi * fit.sigma**2)).sum(axis=1)

    def log_density_at(self, fit: Fit, mean: Float[np.ndarray, " K"], precision: Float[np.ndarray, " K"]) -> float:
        """Log-density of all folds under the noise of `fit`, its columns refitted here as far as `precision` allows."""
        psi = np.concatenate([np.ones((len(fit.phi), 1)), -fit.phi], axis=1)
        full = np.concatenate([[0], fit.columns + 1])
        part = self.gram.sum(axis=0)[:, :, :, full[:, None], full[None, :]]
        white = np.einsum("ca,cb,cabkl,c->kl", psi, psi, part, fit.sigma**-2, optimize=True)
        own = precision[fit.columns]
        step = inverse(white[1:, 1:] + np.diag(own)) @ (white[1:, 0] + own * mean[fit.columns])
        here = Fit(fit.columns, step, fit.covariance, fit.phi, fit.sigma, fit.log_likelihood, fit.penalty)
        return float(self.log_density(here).sum())


class Products:
    """Lagged sensitivities kept at hand, so that only the residual's products are formed anew for each replicate."""

    def __init__(self, lagged: Lagged, S: Float[np.ndarray, "m c k"], folds: Sequence[Sequence[slice]]) -> None:
        self.gram, self.count = lagged.gram.sum(axis=0), lagged.count.sum(keepdims=True)
        self.stretches = [stretch for stretches in folds for stretch in stretches]
        self.used, self.past = [], []
        for c in range(S.shape[1]):
            used = np.flatnonzero(np.any(S[:, c] != 0.0, axis=0))
            parts = [_lags(S[s, c][:, used]) for s in self.stretches]
            self.used.append(used)
            self.past.append(np.concatenate(parts, axis=1).transpose(1, 0, 2).reshape(-1, (ORDER + 1) * len(used)))

    def replicates(self, residuals: Float[np.ndarray, "r m c"]) -> Iterator[Lagged]:
        """The same sensitivities with each of the residuals; one working array is used over and over."""
        count, lags = len(residuals), ORDER + 1
        own, cross = [], []
        for c, used in enumerate(self.used):
            e = np.concatenate([_lags(residuals[:, s, c].T).transpose(1, 0, 2) for s in self.stretches])  # m lag r
            flat = e.reshape(len(e), -1)
            cross.append((flat.T @ self.past[c]).reshape(lags, count, lags, len(used)))
            own.append(np.einsum("mir,mjr->rij", e, e, optimize=True))
        gram = self.gram.copy()
        for r in range(count):
            for c, used in enumerate(self.used):
                gram[c, :, :, 0, 0] = own[c][r]
                gram[c, :, :, 0, used + 1] = cross[c][:, r].transpose(2, 0, 1)
                gram[c, :, :, used + 1, 0] = cross[c][:, r].transpose(2, 1, 0)
            yield Lagged(gram[None], self.count)


def _lags(x: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "p m k"]:
    return np.stack([x[ORDER - i : len(x) - i] for i in range(ORDER + 1)])

    def log_density_at(self, fit: Fit, mean: Float[np.ndarray, " K"], precision: Float[np.ndarray, " K"]) -> float:
        """Log-density of all folds under the noise of `fit`, its columns refitted here as far as `precision` allows."""
        psi = np.concatenate([np.ones((len(fit.phi), 1)), -fit.phi], axis=1)
        full = np.concatenate([[0], fit.columns + 1])
        part = self.gram.sum(axis=0)[:, :, :, full[:, None], full[None, :]]
        white = np.einsum("ca,cb,cabkl,c->kl", psi, psi, part, fit.sigma**-2, optimize=True)
        own = precision[fit.columns]
        step = inverse(white[1:, 1:] + np.diag(own)) @ (white[1:, 0] + own * mean[fit.columns])
        here = Fit(fit.columns, step, fit.covariance, fit.phi, fit.sigma, fit.log_likelihood, fit.penalty)
        return float(self.log_density(here).sum())


def inverse(matrix: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """Inverse of a symmetric positive matrix whose scales differ by many orders."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.linalg.inv(matrix * np.outer(scale, scale) + 1e-12 * np.eye(len(matrix))) * np.outer(scale, scale)


def _autoregression(lagged: Float[np.ndarray, "j c p p"]) -> Float[np.ndarray, "j c p"]:
    """Least-squares coefficients from inner products of the residual with its past; kept stationary by shrinking."""
    past = lagged[:, :, 1:, 1:]
    size = np.trace(past, axis1=2, axis2=3)[:, :, None, None]
    ridge = 1e-9 * np.maximum(size, 1e-300) * np.eye(ORDER)
    return np.linalg.solve(past + ridge, lagged[:, :, 1:, :1])[..., 0]


def stationary(phi: Float[np.ndarray, "c p"], limit: float = 0.999) -> Float[np.ndarray, "c p"]:
    """The same coefficients with every root drawn inside the circle of radius `limit`, so that noise can be simulated."""
    out = np.array(phi)
    for c, row in enumerate(phi):
        roots = np.roots(np.concatenate([[1.0], -row]))
        size = np.abs(roots)
        roots = np.where(size > limit, roots * limit / np.maximum(size, 1e-300), roots)
        out[c] = -np.real(np.poly(roots))[1:]
    return out
