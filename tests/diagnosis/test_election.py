"""What a candidate is worth where folds have gaps between them, as those of a single manoeuvre do."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import lstsq
from test_mixing import part

from bayes_aero.diagnosis.screening.autocorrelation import Autocorrelation
from bayes_aero.diagnosis.screening.partialled_regression import PartialledRegression
from bayes_aero.diagnosis.screening.regression import Products
from bayes_aero.diagnosis.screening.screening import block_jackknife_covariance
from bayes_aero.diagnosis.screening.selection_state import SelectionState


@pytest.mark.parametrize("gap", [0, 40])
def test_information_is_what_the_model_cannot_follow_in_the_folds(gap):
    """Against least squares on the folds alone; a candidate that the model follows everywhere has none."""
    rng = np.random.default_rng(gap)
    n, k = 900, 4
    folds = tuple(slice(begin, begin + 300 - gap) for begin in (0, 300, 600))
    S = np.cumsum(rng.standard_normal((n, 3, k + 2)), axis=0) + rng.uniform(3.0, 9.0, k + 2)
    S[:, :, k] = S[:, :, :k] @ rng.standard_normal(k)
    residual = rng.standard_normal((n, 3)) * [1.0, 0.1, 3.0]
    active = np.arange(k)
    fit = Products.of(residual, S, folds).fit(active, np.zeros(k + 2), np.zeros(k + 2))
    state = part(SelectionState, S=S, noise_growth=np.ones((n, 3)), folds=folds)
    found = PartialledRegression(state, fit, [np.array([k]), np.array([k + 1])]).information

    inside = np.concatenate([np.arange(n)[fold] for fold in folds])
    A = (S[inside] / np.sqrt(fit.variance)[:, None]).reshape(-1, k + 2)
    left = A[:, k + 1] - A[:, :k] @ lstsq(A[:, :k], A[:, k + 1])[0]
    assert found[1, 1] == pytest.approx(left @ left, rel=1e-6)
    assert found[0, 0] < 1e-12 * (A[:, k] @ A[:, k])


def test_two_rivals_are_told_apart_by_the_noise_along_what_parts_them():
    """Log likelihood ratios of two simple hypotheses have a variance of twice their mean; so has the white one, over
    `apart`, under a colour that white noise does not know."""
    rng = np.random.default_rng(4132)
    n, phi = 800, rng.uniform(0.5, 0.9)
    colour = Autocorrelation(np.array([[phi, 0.0, 0.0]]), np.array([np.sqrt(1.0 - phi**2)]))
    folds = (slice(0, n),)
    t = np.linspace(0.0, 1.0, n)
    period = rng.uniform(0.05, 0.4)
    S = np.stack([np.ones(n), t, np.sin(2.0 * np.pi * t / period), t**2, np.zeros(n)], axis=1)[:, None, :]
    fit = Products.of(colour.simulate(1, folds, n, rng)[0], S, folds).fit(np.arange(2), np.zeros(5), np.zeros(5))
    fit = replace(fit, variance=np.ones(1), normal=S[:, 0, :2].T @ S[:, 0, :2])
    projected = PartialledRegression(
        part(SelectionState, S=S, noise_growth=np.ones((n, 1)), folds=folds), fit, [np.array([2]), np.array([3])]
    )
    sizes = [np.array([0.3]), np.array([2.0])]
    apart = projected.apart(np.zeros((n, 1)), sizes, 0, colour, None)
    assert apart[0] == 1.0

    d = projected.P[:, 0, :] @ np.array([-sizes[0][0], sizes[1][0]])
    covariance = phi ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    assert apart[1] == pytest.approx(d @ covariance @ d / (d @ d), rel=0.05)  # but for the ends of the record

    ratios = (0.5 * d @ d - colour.simulate(4000, folds, n, rng)[:, :, 0] @ d) / apart[1]
    assert ratios.var() == pytest.approx(2.0 * ratios.mean(), rel=0.15)


def test_stretches_that_disagree_more_than_the_colour_says_part_rivals_less():
    rng = np.random.default_rng(4132)
    n, stretches = 400, np.repeat(np.arange(20), 20)
    S = np.stack([np.ones(n), *rng.standard_normal((2, n)) + np.repeat(rng.standard_normal((2, 20)), 20, axis=1)])
    S = np.append(S, np.zeros((1, n)), axis=0).T[:, None, :]
    residual = np.repeat(rng.standard_normal(20), 20)[:, None]
    folds, white = (slice(0, n),), Autocorrelation(np.zeros((1, 3)), np.ones(1))
    fit = Products.of(residual, S, folds).fit(np.arange(1), np.zeros(4), np.zeros(4))
    projected = PartialledRegression(
        part(SelectionState, S=S, noise_growth=np.ones((n, 1)), folds=folds), fit, [np.array([1]), np.array([2])]
    )
    estimates = [np.zeros(1), np.ones(1)]
    alone, together = (projected.apart(residual, estimates, 0, white, s)[1] for s in (None, stretches))
    sums = np.add.reduceat(projected.P[:, 0, 1] * residual[:, 0], np.arange(0, n, 20)) / fit.variance[0]
    assert together == pytest.approx(np.sum(sums**2) * 20 / 19 / np.sum(projected.P[:, 0, 1] ** 2 / fit.variance[0]))
    assert together > alone


def test_deviations_are_those_of_fits_without_each_stretch():
    """Against least squares done again without each stretch; one of them alone decides the second parameter."""
    rng = np.random.default_rng(4132)
    count, length, k = 8, 30, 3
    n, stretch = count * length, np.repeat(np.arange(count), length)
    S = np.zeros((n, 2, k + count))
    S[:, :, :k] = rng.standard_normal((n, 2, k))
    S[stretch != 3, :, 1] *= 0.05
    for number in range(count):
        S[stretch == number, :, k + number] = 1.0
    residual = rng.standard_normal((n, 2)) * [1.0, 3.0] + np.repeat(rng.standard_normal((count, 2)), length, axis=0)
    precision = np.append(np.full(k, 4.0), np.zeros(count))
    folds = (slice(0, n),)
    known = np.array([1.0, 9.0])
    fit = Products.of(residual, S, folds).fit(np.arange(k + count), np.zeros(k + count), precision, known)
    fit = replace(fit, variance=known)
    state = part(
        SelectionState,
        S=S,
        residual=residual,
        noise_growth=np.ones((n, 2)),
        folds=folds,
        precision=precision,
        nuisance=count,
    )
    object.__setattr__(state, "theta", np.zeros(k))
    flights = SimpleNamespace(lengths=[length] * count)
    object.__setattr__(state, "responses", SimpleNamespace(jackknife_blocks=stretch, flights=flights))
    columns, covariance = block_jackknife_covariance(state, fit)
    assert list(columns) == [0, 1, 2]

    weight = np.tile(1.0 / np.sqrt(known), n)
    prior = np.hstack([np.diag(np.sqrt(precision[:k])), np.zeros((k, count))])

    def estimate(kept):
        rows = np.repeat(kept, 2)
        A = (S.reshape(2 * n, -1) * weight[:, None])[rows]
        b = (residual.ravel() * weight)[rows]
        return lstsq(np.vstack([A, prior]), np.append(b, np.zeros(k)))[0][:k]

    every = estimate(np.ones(n, bool))
    moves = np.array([estimate(stretch != number) - every for number in range(count)])
    expected = moves.T @ moves * (count - 1) / count
    np.testing.assert_allclose(covariance, expected, rtol=1e-6, atol=1e-6 * np.diag(expected).min())
