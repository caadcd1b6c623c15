"""Cramer-Rao bounds corrected for residuals that are coloured and whose size changes along the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from scipy.fft import next_fast_len
from scipy.linalg.lapack import dtbtrs  # pyright: ignore[reportAttributeAccessIssue]
from scipy.optimize import nnls

from bayes_aero.arrays import AnyArray

Square = Float[np.ndarray, "k k"]
Outputs = Float[np.ndarray, " c"]
Residual = Float[np.ndarray, "n c"]
Sensitivity = Float[np.ndarray, "n c k"]
Numbers = Int[np.ndarray, " n"]
Marks = Bool[np.ndarray, " n"]

BLOCK = 0.2  # s; smoothed residuals vary no faster
MIN_INNOVATIONS = 10  # for each coefficient of an autoregression; with fewer, blocks count as independent
MIN_RESIDUAL_SHARE = 0.05  # least share 1 - h of an innovation that the fit leaves, with the leverage h of its block


def robust_covariance(
    D: Square, S: Sensitivity, R: Outputs, residual: Residual, manoeuvre: Numbers, start: Marks, dt: float
) -> tuple[Square, int]:
    """Covariance D M D of the estimate, with M that of the score sum S' R^-1 r, and the number of blocks."""
    # Residuals are averaged over blocks of `BLOCK` seconds and whitened by an autoregression for each coefficient (the
    # sensitivities by its transpose, so that the score is unchanged). M is then formed twice: from the innovations'
    # covariance, as in the corrected bound of Morelli and Klein, and from each block's own innovations, which also
    # holds where the residual grows with the sensitivity, as it does where noise of the flow angle is in a regressor
    # (HC3: each is divided by the share 1 - h that the fit leaves of it). The larger variance is taken. It is scaled by
    # Student's t with the number of blocks less the number of parameters as degrees of freedom. Source: Morelli and
    # Klein, J. Aircraft 34 (1997) 211; prewhitening: Andrews and Monahan, Econometrica 60 (1992) 953; HC3 and the
    # larger of both: MacKinnon and White, J. Econometrics 29 (1985) 305; Angrist and Pischke, *Mostly Harmless
    # Econometrics*, 2009, ch. 8.
    from scipy.signal import lfilter  # here, for commands that only read records do without it
    from scipy.stats import norm, t

    begins = np.flatnonzero(np.asarray(start) | np.append(True, np.diff(manoeuvre) != 0))
    stretches = []  # block means of stretches without gaps, and the number of samples of each block
    for a, b in zip(begins, np.append(begins[1:], len(start)), strict=True):
        edges = np.arange(0, b - a, max(1, round(BLOCK / dt)))
        samples = np.diff(np.append(edges, b - a)).astype(float)
        r, slope = (np.add.reduceat(x[a:b], edges, axis=0) for x in (residual, S))
        stretches.append((r / samples[:, None], slope / samples[:, None, None], samples))
    phi, long = np.zeros((S.shape[1], ORDER)), [r for r, _, _ in stretches if len(r) > 2 * ORDER]
    if sum(len(r) - ORDER for r in long) >= MIN_INNOVATIONS * ORDER:
        phi = np.stack([autoregression([r[None, :, c] for r in long])[0][0] for c in range(S.shape[1])])
    shaped, shares, innovations = [], [], []
    # Innovations e = A r, and A^-T of the weighed sensitivities: e times these is the score.
    for r, slope, samples in stretches:
        weighed = slope * samples[:, None, None] / R[:, None]
        filters = [np.append(1.0, -lags) for lags in phi]
        innovations.append(np.stack([lfilter(f, [1.0], x) for f, x in zip(filters, r.T, strict=True)], axis=1))
        back = [lfilter([1.0], f, weighed[::-1, c], axis=0) for c, f in enumerate(filters)]
        shaped.append(np.stack(back, axis=1)[::-1])
        shares.append(np.einsum("bck,kl,bcl->bc", slope, D, slope, optimize=True) * samples[:, None] / R)
    e, W, share = (np.concatenate(x) for x in (innovations, shaped, shares))
    left = max(len(e) - max(int(np.count_nonzero(np.any(S[:, c] != 0.0, axis=0))) for c in range(S.shape[1])), 1)
    stationary = D @ np.einsum("bck,cd,bdl->kl", W, e.T @ e / left, W, optimize=True) @ D
    scores = np.einsum("bck,bc->bk", W, e / np.maximum(1.0 - share, MIN_RESIDUAL_SHARE))
    by_block = D @ (scores.T @ scores) @ D
    sd = np.sqrt(np.maximum(np.diag(stationary), np.diag(by_block)))
    narrow = np.sqrt(np.maximum(np.diag(by_block), np.finfo(float).tiny))
    widen = sd / narrow * t.ppf(0.975, left) / norm.ppf(0.975)
    return by_block * np.outer(widen, widen), len(e)


# --- Cramer-Rao bounds corrected for coloured residuals.

LAG_SHARE = 0.2  # longest lag as a share of the shortest stretch; our choice, see `autocovariance`
SENSOR_MEMORY = (0.0, 0.3, 2.0)  # s: time constants of the modelled noise of a sensor; 0: white; our choice
DRAWS = 20  # of the modelled noise, for each mean


def autocovariance(residual: Float[np.ndarray, "n c"], lags: int) -> Float[np.ndarray, "m c c"]:
    """Autocovariance R(k) = (1/n) sum_i r_i r_(i-k)' for k = -lags .. lags, tapered by Parzen's window."""
    # The biased estimate with a positive-definite window keeps the sequence positive semidefinite, so no corrected
    # variance can come out negative. The full untapered sequence would sum to nearly zero, because the fitted residuals
    # are orthogonal to the sensitivities; the window is what makes it consistent.
    n, _ = residual.shape
    size = int(next_fast_len(2 * n) or 2 * n)
    spectrum = np.fft.rfft(residual, size, axis=0)
    full = np.fft.irfft(np.einsum("fi,fj->fij", spectrum, spectrum.conj()), size, axis=0) / n
    k = np.arange(-lags, lags + 1)
    x = np.abs(k / (lags + 1.0))
    window = np.where(x <= 0.5, 1.0 - 6.0 * x**2 * (1.0 - x), 2.0 * (1.0 - np.minimum(x, 1.0)) ** 3)
    return full[k] * window[:, None, None]


def corrected_covariance(
    D: Square, S: Sensitivity, R: Outputs, residual: Residual, manoeuvre: Numbers, start: Marks
) -> Square:
    """D [sum_i S_i' R^-1 sum_j Rvv(i-j) R^-1 S_j] D with D = (sum S' R^-1 S)^-1, manoeuvre by manoeuvre."""
    # Source: corrected bound of Morelli and Klein, J. Aircraft 1997; Rvv is the residuals' autocovariance. Manoeuvres
    # are taken as independent. Where samples are left out (`start` inside a manoeuvre) only whole stretches count as
    # neighbours, and the autocovariance is that of the longest stretch.
    W = S / R[:, None]
    total = np.zeros_like(D)
    for number in np.unique(manoeuvre):
        inside = np.flatnonzero(manoeuvre == number)
        stretches = np.split(inside, np.flatnonzero(start[inside])[1:])
        longest = max(stretches, key=len)
        lags = max(1, int(LAG_SHARE * len(longest)))
        covariance = autocovariance(residual[longest], lags)
        for stretch in stretches:  # sum_ij W_i' Rvv(i-j) W_j by convolution over time
            weighed, n = W[stretch], len(stretch)
            size = int(next_fast_len(n + 2 * lags) or n + 2 * lags)
            kernel = np.zeros((size, *covariance.shape[1:]))
            kernel[np.arange(-lags, lags + 1)] = covariance
            spectra = np.fft.rfft(kernel, axis=0), np.fft.rfft(weighed, size, axis=0)
            spread = np.fft.irfft(np.einsum("fij,fjk->fik", *spectra), size, axis=0)[:n]
            total += np.einsum("nci,ncj->ij", weighed, spread)
    return D @ total @ D


def standard_error_of_sum(values: Float[np.ndarray, " m"], lengths: Sequence[int]) -> float:
    """Standard error of the sum of an autocorrelated series of constant mean with independent stretches."""
    # Too small where the correlation time is nearly as long as `LAG_SHARE` of a stretch.
    centred = (values - values.mean())[:, None]
    parts = np.split(centred, np.cumsum(lengths)[:-1])
    variance = sum(len(part) * autocovariance(part, max(1, int(LAG_SHARE * len(part)))).sum() for part in parts)
    return float(np.sqrt(variance * len(values) / (len(values) - 1)))


@dataclass(frozen=True)
class LinearFit:
    """A fit of k parameters and of the initial state of each of w segments, linear in the noise of the outputs."""

    D: Square  # covariance of the parameters for white noise
    S: Float[np.ndarray, "w n c k"]  # sensitivities to them, with initial states at their optimum
    own: Float[np.ndarray, "w n c s"]  # sensitivities to initial states
    precision: Float[np.ndarray, " s"]  # of the priors of the latter, infinite where they are not fitted
    R: Outputs  # variances of the residuals
    inside: Bool[np.ndarray, "w n"]  # the other samples are zeros

    @cached_property
    def weights(self) -> Float[np.ndarray, "w n c k"]:
        return (self.S / self.R[:, None]) @ self.D

    @cached_property
    def _state_covariance(self) -> Float[np.ndarray, "w s s"]:
        fitted = np.isfinite(self.precision)
        A = np.einsum("wncs,c,wnct->wst", self.own, 1.0 / self.R, self.own, optimize=True)
        A = A + np.diag(np.where(fitted, self.precision, 0.0))
        size = np.sqrt(np.einsum("wss->ws", A))
        scale = np.divide(1.0, size, out=np.zeros_like(size), where=fitted & (size > 0.0))
        scale = scale[:, :, None] * scale[:, None, :]
        return scale * np.linalg.pinv(scale * A, hermitian=True)

    def residual(self, noise: Float[np.ndarray, "... w n c"]) -> Float[np.ndarray, "... w n c"]:
        theta = np.einsum("wnck,...wnc->...k", self.weights, noise, optimize=True)
        states = np.einsum("wnct,...wnc->...wt", self.own, noise / self.R, optimize=True)
        states = np.einsum("wst,...wt->...ws", self._state_covariance, states)
        taken = np.einsum("wnck,...k->...wnc", self.S, theta, optimize=True)
        return noise - taken - np.einsum("wncs,...ws->...wnc", self.own, states, optimize=True)


def segments_corrected(
    D: Square, S: np.ndarray, R: Outputs, residual: np.ndarray, inside: Bool[np.ndarray, "w n"]
) -> Square:
    """`corrected_covariance` of segments, as rows, of which only the samples `inside` count."""
    segment = np.nonzero(inside)[0]
    return corrected_covariance(D, S[inside], R, residual[inside], segment, np.diff(segment, prepend=-1) != 0)


def means(x: Shaped[np.ndarray, "w n ..."], size: int) -> Float[np.ndarray, "w m ..."]:
    """Means over `size` samples; those that remain at the end are left out."""
    whole = x.shape[1] // size * size
    return x[:, :whole].reshape(len(x), -1, size, *x.shape[2:]).mean(axis=2)


def calibration(fit: LinearFit, residual: Float[np.ndarray, "w n c"], dt: float) -> Float[np.ndarray, " k"]:
    """Variances of the estimates over those of `corrected_covariance`, (k,), for noise as the `residual` shows it."""
    # A fit takes out of the residuals what is like its sensitivities, above all what disturbs the flight and adds up in
    # its motion; and the window, a fixed share of the record, leaves the variance uncertain. Both are calculated for a
    # model of the noise: of each sensor, white and of first order with the time constants `SENSOR_MEMORY`, and random
    # disturbances of each state, whose response is that to the initial state, later. The intensities are those with
    # which the residuals, filtered by each response, have the expected mean squares after the fit. `fit` and `residual`
    # are means over some samples, `dt` apart. Source: Rao, J. Multivariate Analysis 1 (1971) 257 (intensities by
    # expected squares); Beran, Biometrika 74 (1987) 457 (calibration by draws of the estimated noise).
    (w, n, c), rng = residual.shape, np.random.default_rng(0)
    size = int(next_fast_len(2 * n) or 2 * n)
    time = dt * np.arange(n)[:, None, None]
    sensors = [np.sqrt(fit.R) * np.eye(c) * (np.exp(-time / x) if x else time == 0.0) for x in SENSOR_MEMORY]
    shapes = np.concatenate([*(np.broadcast_to(x, (w, n, c, c)) for x in sensors), fit.own], axis=3)
    norm = np.sqrt(np.einsum("wncj,c->j", shapes**2, 1.0 / fit.R))
    L = np.fft.rfft(shapes[..., norm > 0.0] / norm[norm > 0.0], size, axis=1)

    def left(intensity: Float[np.ndarray, " j"]) -> Float[np.ndarray, "d w n c"]:
        on = np.flatnonzero(intensity)
        white = rng.standard_normal((DRAWS, w, n, len(on))) * np.sqrt(intensity[on])
        spectrum = np.einsum("wfcj,dwfj->dwfc", L[..., on], np.fft.rfft(white, size, axis=2), optimize=True)
        return fit.residual(np.fft.irfft(spectrum, size, axis=2)[:, :, :n] * fit.inside[:, :, None])

    def squares(x: Float[np.ndarray, "d w n c"]) -> Float[np.ndarray, "d j"]:
        along = np.einsum("wfcj,dwfc->dwfj", L.conj(), np.fft.rfft(x, size, axis=2), optimize=True)
        return np.sum(np.fft.irfft(along, size, axis=2)[:, :, :n] ** 2, axis=(1, 2))

    seen = squares(residual[None] / fit.R)[0]
    if not (np.all(np.isfinite(seen)) and np.all(seen > 0.0)):
        return np.ones(len(fit.D))
    expected = [squares(left(one) / fit.R).mean(axis=0) for one in np.eye(len(seen))]
    intensity = nnls(np.stack(expected, axis=1) / seen[:, None], np.ones(len(seen)), maxiter=100 * len(seen))[0]
    exact = squares(np.moveaxis(fit.weights, 3, 0)) @ intensity
    seen_inside = fit.D, fit.S, fit.R
    drawn = np.array([np.diag(segments_corrected(*seen_inside, x, fit.inside)) for x in left(intensity)])
    moving = np.all(drawn > 0.0, axis=0)
    return np.where(moving, exact * np.mean(1.0 / np.where(moving, drawn, 1.0), axis=0), 1.0)


def covariance_of(information: Float[np.ndarray, "j j"], moving: Bool[np.ndarray, " j"]) -> Float[np.ndarray, "j j"]:
    """Inverse of the information of the estimated variables; zero for held ones and those without information."""
    # The pseudo-inverse is taken of the matrix scaled to unit diagonal. In SI units it would drop a length in metres
    # beside angles in radians.
    informed = moving & (np.diag(information) > 0.0)
    block = information[np.ix_(informed, informed)]
    scale = np.sqrt(np.outer(np.diag(block), np.diag(block)))
    covariance = np.zeros_like(information)
    covariance[np.ix_(informed, informed)] = np.linalg.pinv(block / scale, hermitian=True) / scale
    return covariance


# --- Covariance from the scatter between blocks of a record, for any autocorrelation within a block.
# `robust_covariance` corrects each block by its leverage (HC3) instead, `standard_error_of_sum` has no blocks.


def cluster_covariance(contributions: Float[np.ndarray, "m k"], block: Int[np.ndarray, " m"]) -> Square:
    """Covariance of a sum whose expectation is zero: n/(n - 1) sum_g s_g s_g' with the sums s_g of n blocks."""
    # `contributions` of each sample: residuals weighed by sensitivities give the score's. Source: Liang and Zeger,
    # Biometrika 73 (1986) 13.
    count = int(block.max()) + 1
    sums = np.zeros((count, contributions.shape[1]))
    np.add.at(sums, block, contributions)
    return sums.T @ sums * count / (count - 1.0)


def jackknife_covariance(moves: Float[np.ndarray, "n k"]) -> Square:
    """Covariance of an estimate from its `moves` when each of n blocks is left out: (n - 1)/n sum_g d_g d_g'."""
    # A block that alone determines a parameter has no residual in its direction; `cluster_covariance` takes this for
    # agreement. Source: Bell and McCaffrey, Survey Methodology 28 (2002) 169, for moves from the estimate by all
    # blocks; Efron and Tibshirani, An Introduction to the Bootstrap (1993), ch. 11, for moves from their mean.
    return moves.T @ moves * (len(moves) - 1.0) / len(moves)


# --- Autoregressions of residuals by least squares, kept stationary.

ORDER = 3  # at some 5 samples a second; our choice
MAX_ROOT = 0.995  # largest root: a memory of 40 s at 5 samples a second


def autoregression(
    folds: Sequence[Float[np.ndarray, "r _"]],
) -> tuple[Float[np.ndarray, "r p"], Float[np.ndarray, " r"]]:
    """Coefficients, and the standard deviation of the innovation, of one output in r records."""
    lags = [[x[:, ORDER - i : x.shape[1] - i] for i in range(ORDER + 1)] for x in folds]
    gram = np.empty((len(folds[0]), ORDER + 1, ORDER + 1))
    for i in range(ORDER + 1):
        for j in range(i, ORDER + 1):
            gram[:, i, j] = gram[:, j, i] = sum(np.einsum("rt,rt->r", lag[i], lag[j]) for lag in lags)
    past, right = gram[:, 1:, 1:], gram[:, 1:, :1]
    ridge = 1e-9 * np.trace(past, axis1=1, axis2=2) + 1e-300
    phi = stationary_coefficients(np.linalg.solve(past + ridge[:, None, None] * np.eye(ORDER), right)[:, :, 0])
    squares = sum(
        np.sum((now - sum(p[:, None] * x for p, x in zip(phi.T, past, strict=True))) ** 2, axis=1)
        for now, *past in lags
    )
    return phi, np.sqrt(squares / sum(lag[0].shape[1] for lag in lags))


def stationary_coefficients(phi: Float[np.ndarray, "r p"]) -> Float[np.ndarray, "r p"]:
    """Autoregressions with no root larger than `MAX_ROOT`; larger roots are scaled to it."""
    companion = np.zeros((len(phi), ORDER, ORDER))
    companion[:, 0] = phi
    companion[:, 1:, :-1] = np.eye(ORDER - 1)
    roots, limited = np.linalg.eigvals(companion), phi.copy()
    size = np.abs(roots)
    outside = np.any(size > MAX_ROOT, axis=1)
    inside = np.where(size > MAX_ROOT, roots * MAX_ROOT / np.maximum(size, 1e-300), roots)[outside]
    product = np.ones((len(inside), 1))  # of (1 - root L), by powers of the lag L
    for root in inside.T[:, :, None]:
        product = np.pad(product, ((0, 0), (0, 1))) - root * np.pad(product, ((0, 0), (1, 0)))
    limited[outside] = -np.real(product[:, 1:])
    return limited


def filtered_noise(
    phi: Float[np.ndarray, "p ..."],
    innovations: Float[np.ndarray, "t ..."],
    past: Float[np.ndarray, "p ..."] | None = None,
) -> Float[np.ndarray, "t ..."]:
    """x[t] = sum phi[i] x[t-1-i] + e[t] after the samples `past` (default: zeros), for many series at once."""
    order, weights = len(phi), phi[::-1]
    past = np.zeros((order, *innovations.shape[1:])) if past is None else past
    series = np.concatenate([past, innovations])
    for i in range(len(innovations)):
        series[i + order] += np.add.reduce(weights * series[i : i + order])
    return series[order:]


FEW = 20  # autoregressions that filter rows one after the other; of more, sums over lags are faster
LARGE = 1e5  # variance of a series over that of its innovation beyond which those lose too many digits


def shaped_products(
    phi: Float[np.ndarray, "r p"], rows: Float[np.ndarray, "n t"], pairs: Int[np.ndarray, "j 2"]
) -> Float[np.ndarray, "r j"]:
    """Inner products of pairs of rows, both filtered from rest by each of r autoregressions."""
    (i, j), (r, order), (n, t) = pairs.T, phi.shape, rows.shape
    if r <= FEW or t <= order or not n:
        bands = [np.append(1.0, -row)[:, None] * np.ones(t) for row in phi]
        each = (dtbtrs(band, rows.T, uplo="L", diag="U")[0].T if n else rows for band in bands)
        return np.array([np.einsum("jt,jt->j", shaped[i], shaped[j]) for shaped in each])
    # Were the rows filtered on into infinity, it would be their correlation times the autocovariance of the series, lag
    # by lag. What comes after the last sample, a quadratic form in the last filtered ones, is taken off.
    companion, eye = np.tile(np.eye(order, k=-1), (r, 1, 1)), np.eye(order)
    companion[:, 0], now = phi, np.outer(eye[0], eye[0])
    A = np.eye(order**2) - np.einsum("rij,rkl->rikjl", companion, companion).reshape(r, order**2, order**2)
    covariance, whole = np.linalg.solve([A, A.transpose(0, 2, 1)], now.reshape(-1, 1)).reshape(2, r, order, order)
    past = np.stack([covariance[:, 0], np.tile(eye[0], (r, 1))])[:, :, ::-1].transpose(2, 0, 1)
    series = np.concatenate([past[-1:], filtered_noise(phi.T[:, None], np.zeros((t - 1, 2, r)), past)])
    autocovariance, response = series.transpose(1, 2, 0)
    spectra = np.fft.rfft(rows, size := int(next_fast_len(2 * t, real=True) or 2 * t))
    lags = np.fft.irfft(spectra[i].conj() * spectra[j], size)
    lags[:, 1:t] += lags[:, : size - t : -1]
    last = np.stack([response[:, : t - k] @ rows[:, t - 1 - k :: -1].T for k in range(order)], axis=2)
    found = autocovariance @ lags[:, :t].T - np.sum((last[:, i] @ (whole - now)) * last[:, j], axis=2)
    for k in np.flatnonzero(covariance[:, 0, 0] > LARGE):
        found[k] = shaped_products(phi[k : k + 1], rows, pairs)[0]
    return found


def stationary_series(
    phi: Float[np.ndarray, "p ..."], innovations: Float[np.ndarray, "t ..."]
) -> Float[np.ndarray, "t ..."]:
    """`filtered_noise` from the stationary distribution; Brockwell and Davis, Time Series: Theory and Methods, 5.2."""
    # Each of the first samples is predicted from those before it: Durbin's recursion, downwards.
    order = len(phi)
    predictors, variances = [phi], [np.ones(phi.shape[1:])]
    for _ in range(order):
        longer, last = predictors[0], predictors[0][-1]
        share = 1.0 - last**2
        predictors.insert(0, (longer[:-1] + last * longer[-2::-1]) / share)
        variances.insert(0, variances[0] / share)
    first: list[np.ndarray] = []
    for k, e in enumerate(innovations[:order]):
        first.append(np.sqrt(variances[k]) * e + sum(c * x for c, x in zip(predictors[k], first[::-1], strict=True)))
    past = np.array(first).reshape(len(first), *innovations.shape[1:])
    return past if len(first) < order else np.concatenate([past, filtered_noise(phi, innovations[order:], past)])


# --- Variance inflation: the factor by which autocorrelated residuals increase variances; likelihoods divided by it.


def variance_inflation(variance: Float[np.ndarray, " k"], white: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Variance of each estimate over that for white residuals; 1 where the latter is zero."""
    return np.divide(variance, white, out=np.ones_like(white), where=white > 0.0)


def median_inflation(inflation: Float[np.ndarray, " k"]) -> float:
    """Median of the variance inflation of several estimates, at least 1."""
    return max(1.0, float(np.median(inflation))) if len(inflation) else 1.0


def nats(deviance: float, inflation: float) -> float:
    """Log likelihood of a decrease of the deviance of white residuals, divided by the variance inflation (>= 1)."""
    return deviance / (2.0 * max(inflation, 1.0))


# --- Log scores of predictions of hold-out data.


def log_density(error: Float[AnyArray, "*n"], variance: Float[AnyArray, "*#n"]) -> Float[np.ndarray, "*n"]:
    """Log density of each error of a normal prediction with this variance."""
    return -0.5 * (error**2 / variance + np.log(2.0 * np.pi * variance))


def log_score_gain(
    before: Float[np.ndarray, " m"], after: Float[np.ndarray, " m"], inflation: float, lengths: Sequence[int]
) -> tuple[float, float]:
    """Gain in log score of one prediction over another of the same hold-out data, and its standard error, nats."""
    # Log densities of m samples, in independent stretches of these `lengths`; the gain is over the variance
    # `inflation`.
    difference = (after - before) / inflation
    return float(difference.sum()), standard_error_of_sum(difference, lengths)
