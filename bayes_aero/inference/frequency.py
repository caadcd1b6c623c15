"""Fits in a band of frequencies: lines of the band, Gauss-Newton with Cramer-Rao bounds, frequency responses.

The cost is that of `inference.mle`, det R with a diagonal R. The estimates are real, so the real and the
imaginary part of a line count as two residuals. Published bounds count the line as one and are larger by sqrt(2).

Source: Klein and Morelli, *Aircraft System Identification*, 2006, ch. 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float
from scipy.signal import csd

from bayes_aero.dynamics.flight import Dynamics, LinearDynamics, unbiased
from bayes_aero.dynamics.system import LinearSystem
from bayes_aero.errors import InputError
from bayes_aero.flight.card import ONE, Card
from bayes_aero.flight.health import noise_of
from bayes_aero.flight.reading import at_common_rate
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.covariance import BLOCK, robust_covariance
from bayes_aero.inference.mle import noise_bias, scaled_inverse
from bayes_aero.inference.optimise import Evaluation, Problem, Rule, Vector, minimise, truncated_step
from bayes_aero.inference.results import FrequencyFit, FrequencyResponse, MleResult
from bayes_aero.model.model import Model
from bayes_aero.model.observations import join
from bayes_aero.model.records import Flights
from bayes_aero.parameter import Parameter
from bayes_aero.physics.aircraft import required_of
from bayes_aero.residuals.equation_error import (
    Band,
    FrequencyError,
    InBand,
    LinearFrequencyError,
    LinearFrequencyOutputError,
)

EQUATION_ERROR, OUTPUT_ERROR = "equation error", "output error"
EXACT = 1e-100  # least variance of an output that its model reproduces: information is still a number
REWEIGHTED = 5  # solutions with renewed variances at one point
TOLERANCE = 1e-4  # gain in log likelihood of one more step: 0.014 standard errors
UNSEEN = 1e-6  # information over that of the prior below which the band does not show a parameter
MIN_SHARE = 0.01  # of the variance in the band: least variance of a difference from the time domain


class BandStep(NamedTuple):
    """A linear solution: the step of the parameters (k,) and of the offsets, what is left (m, c), its mean squares."""

    step: np.ndarray
    left: np.ndarray
    R: np.ndarray

    @property
    def cost(self) -> float:
        return 0.5 * len(self.left) * float(np.sum(np.log(self.R)))


class _Lines(Problem):
    """Minus the log likelihood of the lines of a band, variances and offsets at their optimum."""

    def __init__(self, responses: InBand, parameters: Sequence[Parameter], theta: Vector) -> None:
        residual, S = responses.linearise(theta)
        size = 1.0 / np.maximum(np.mean(np.square(residual), axis=0), EXACT)
        information = np.einsum("mck,mck,c->k", S, S, size)
        shown = information * np.square([p.prior.normal[1] for p in parameters]) > UNSEEN
        super().__init__(np.array([p.bounds for p in parameters], float).reshape(-1, 2), shown)
        self.free, self.responses, self.moved, self.point = shown.copy(), responses, responses, theta
        offsets = responses.offsets(theta, responses.outputs)
        self.tried = residual, S[:, :, self.free], offsets, solve(residual, offsets).cost

    def cost(self, point: Vector) -> float:
        """At the best offsets for the step that leads there; those of the states change the sensitivities."""
        if point is not self.point:
            residual, S = self.moved.linearise(point, np.flatnonzero(self.free))
            offsets = self.moved.offsets(point, self.moved.outputs)
            self.tried = residual, S, offsets, solve(residual, offsets).cost
        return self.tried[-1]

    def evaluate(self, point: Vector) -> Evaluation:
        """At the point that was tried last; parameters at a bound that lead out are held from now on."""
        residual, S, offsets, cost = self.tried
        self.point, self.responses, step = point, self.moved, np.zeros(len(point))
        while True:
            solution = solve(residual, np.concatenate([S, offsets], axis=2))
            if not np.isfinite(solution.cost):
                return Evaluation(np.inf, step, np.eye(len(point)))
            step[self.free] = solution.step[: S.shape[2]]
            out = self.free & np.any((point[:, None] - self.bounds) * [1, -1] <= 0.0, axis=1)
            out &= np.where(point <= self.bounds[:, 0], step < 0.0, step > 0.0)
            if not out.any():
                break
            self.free, step[out] = self.free & ~out, 0.0
            S = self.responses.linearise(point, np.flatnonzero(self.free))[1]
        self.solution, self.moved = solution, self.responses.moved(solution.step[S.shape[2] :])
        weighed, beside = ((x / np.sqrt(solution.R)[:, None]).reshape(residual.size, -1) for x in (S, offsets))
        weighed = weighed - beside @ np.linalg.lstsq(beside, weighed, rcond=None)[0]
        information, free = np.eye(len(point)), np.ix_(self.free, self.free)
        information[free] = weighed.T @ weighed
        return Evaluation(cost, -information @ step, information, cost - solution.cost)


RULE = Rule(
    step=truncated_step,
    gain=lambda *_: 0.0,  # that of the reweighted solution is exact, and given as `Evaluation.gain`
    trials=lambda _: ((share, 0.0) for share in (1.0, 0.5, 0.25, 0.125, 0.03)),
    last=np.inf,  # rounding: no step lowers the cost
    max_steps=50,
)


def fit_in_band(
    responses: InBand, parameters: Sequence[Parameter], start: Vector, band: Band, method: str = EQUATION_ERROR
) -> FrequencyFit:
    """Estimate the free parameters from residuals in a band (Hz), by a model of `residuals.frequency_error`."""
    # Parameters that the band does not show, such as constants, keep their start, SI, of a fit in the time domain.
    lines = _Lines(responses, parameters, np.array(start, float))
    theta, _, converged, _ = minimise(lines, lines.point, TOLERANCE, RULE)
    free, solution, responses, outputs = np.flatnonzero(lines.free), lines.solution, lines.responses, responses.outputs
    S = np.concatenate([responses.linearise(theta, free)[1], responses.offsets(theta, outputs)], axis=2)
    m, k = len(S), len(free)
    R, D = cramer_rao(S, solution.R)
    corrected, regular = D, bool(np.all(np.isfinite(D)))
    if regular:  # each part of a line stands alone: the transform has whitened them, and only their sizes differ
        corrected, _ = robust_covariance(D, S, R, solution.left, responses.manoeuvre, np.ones(m, bool), BLOCK)
    return FrequencyFit(
        method=method,
        band=(float(band[0]), float(band[1])),
        lines=m // 2,
        parameters=tuple(parameters[int(i)] for i in free),
        estimate=theta[free],
        covariance=D[:k, :k],
        corrected=corrected[:k, :k],
        inner={name: S[:, c, :k].T @ S[:, c, :k] for c, name in enumerate(outputs)},
        R=dict(zip(outputs, map(float, R), strict=True)),
        unseen=tuple(p.name for p, shown in zip(parameters, lines.moving, strict=True) if not shown),
        converged=converged and regular,
        at_bound=tuple(parameters[int(i)].name for i in np.flatnonzero(lines.moving & ~lines.free)),
    )


def solve(residual: Float[np.ndarray, "m c"], S: Float[np.ndarray, "m c k"]) -> BandStep:
    """Least squares for all columns, with the variances of the outputs that it leaves."""
    left, step = residual, np.zeros(S.shape[2])
    if not (np.isfinite(residual).all() and np.isfinite(S).all()):  # an unstable system beyond all numbers
        return BandStep(step, left, np.full(S.shape[1], np.inf))
    for _ in range(REWEIGHTED):
        R = np.maximum(np.mean(np.square(left), axis=0), EXACT)
        weighted = (S / np.sqrt(R)[:, None]).reshape(residual.size, len(step))
        scale = np.sqrt(np.maximum(np.sum(np.square(weighted), axis=0), np.finfo(float).tiny))
        step = np.linalg.lstsq(weighted / scale, (residual / np.sqrt(R)).ravel(), rcond=1e-12)[0] / scale
        left = residual - S @ step
    R = np.maximum(np.mean(np.square(left), axis=0), EXACT)
    return BandStep(step, left, R)


def cramer_rao(
    S: Float[np.ndarray, "m c k"], R: Float[np.ndarray, " c"]
) -> tuple[Float[np.ndarray, " c"], Float[np.ndarray, "k k"]]:
    """Variances over degrees of freedom, from mean squares R, and the inverse information; NaN where it is singular."""
    m = len(S)
    used = np.array([np.count_nonzero(np.any(S[:, c] != 0.0, axis=0)) for c in range(S.shape[1])])
    R = R * m / np.maximum(m - used, 1)
    A = np.einsum("mck,mcl,c->kl", S, S, 1.0 / R)
    return R, scaled_inverse(A)[0] if len(A) and np.all(m > used) else np.full_like(A, np.nan)


def without_noise_bias_in_band(
    fit: FrequencyFit, responses: InBand, parameters: Sequence[Parameter], *, seed: int = 0
) -> FrequencyFit:
    """The estimate without the bias by noise of the recorded regressors, as `mle.without_noise_bias` has it."""
    # Source: simulation extrapolation (SIMEX), Cook and Stefanski, J. Am. Stat. Assoc. 89 (1994) 1314.
    if not fit.converged:
        return fit
    flights, rng = responses.flights, np.random.default_rng(seed)
    values = dict(zip(fit.names, fit.estimate, strict=True))
    start = np.array([values.get(p.name, p.start) for p in parameters])

    def draw() -> dict[str, np.ndarray]:
        ends, noise = np.cumsum(flights.lengths)[:-1], {}
        for name in flights.recorded:
            parts = np.split(np.asarray(flights.channels[name], float), ends)
            noise[name] = np.concatenate([noise_of(x) * rng.standard_normal(len(x)) for x in parts])
        return noise

    def refit(noise: dict[str, np.ndarray], sign: float) -> np.ndarray | None:
        noisier = {n: x + sign * noise[n] if n in noise else x for n, x in flights.channels.items()}
        moved = responses.with_channels(noisier)
        assert isinstance(moved, InBand)
        again = fit_in_band(moved, parameters, start, fit.band, fit.method)
        return again.estimate if again.converged and again.names == fit.names else None

    bias = noise_bias(fit.estimate, draw, refit)
    if bias is None:
        return fit
    return replace(fit, estimate=fit.estimate - bias, bias=bias, corrected=fit.corrected + np.outer(bias, bias))


# --- Records fitted in a band: coefficients beside their fit in the time domain, and linear cards.


def coefficients_in_band(
    records: Sequence[FlightRecord], card: Card, model: Model, mle: MleResult, band: Band, *, seed: int = 0
) -> FrequencyFit:
    """Equation error of the coefficients in a band (Hz), beside their fit `mle` in the time domain, where it starts."""
    # The records are without spikes. `InputError`: the band is empty or holds no frequency of a record.
    flights = join(at_common_rate(records), card, required_of(model.axes))
    responses = FrequencyError.in_band(flights, model, band)
    fit = fit_in_band(responses, model.free, mle.estimate, band)
    fit = without_noise_bias_in_band(fit, responses, model.free, seed=seed)
    # Both estimates share the noise of the band. The one in the time domain is M times the one in the band and a part
    # from the other frequencies, which is independent of it; M is the share of the band in the information. So the
    # covariance of the difference is V_t + V_f - M V_f - V_f M', with the corrected covariances of both.
    place = [mle.names.index(name) for name in fit.names]
    V_t, V_f, D = mle.corrected[np.ix_(place, place)], fit.corrected, mle.covariance[np.ix_(place, place)]
    M = D @ sum(inner / mle.R[c] for c, inner in enumerate(fit.inner.values()))
    # M is that of white noise. The difference of the variances, which is exact where one of the estimates is efficient,
    # is the least that is believed.
    least = np.maximum(np.abs(np.diag(V_f - V_t)), MIN_SHARE * np.diag(V_f))
    sd = np.sqrt(np.maximum(np.diag(V_t + V_f - M @ V_f - V_f @ M.T), least))
    apart = np.abs(fit.estimate - mle.estimate[place]) / sd
    return replace(fit, apart=dict(zip(fit.names, map(float, apart), strict=True)))


def linear_in_band(
    flights: Flights, dynamics: Dynamics, band: Band
) -> tuple[tuple[FrequencyFit, FrequencyFit], tuple[FrequencyResponse, ...]]:
    """Equation error of a linear card in a band, output error from there, and responses."""
    # `InputError`: a state was not recorded, sampling times differ, or the band holds no frequency of a record.
    dt = np.asarray(flights.channels["dt"], float)
    if np.ptp(dt) > 1e-6 * dt[0]:
        raise InputError("the manoeuvres have different sampling times; give --resample")
    bare = unbiased(dynamics)
    assert isinstance(bare, LinearDynamics)
    start = np.array([p.start for p in bare.free])
    first = fit_in_band(LinearFrequencyError.in_band(flights, bare, band), bare.free, start, band)
    estimates = dict(zip(first.names, first.estimate, strict=True))
    start = np.array([estimates.get(p.name, p.start) for p in bare.free])
    whole = LinearFrequencyOutputError.in_band(flights, bare, band)
    second = fit_in_band(whole, bare.free, start, band, OUTPUT_ERROR)
    responses = frequency_responses(flights, bare, second) if second.converged else ()
    return (first, second), responses


# --- Frequency responses of a linear card's outputs to its inputs: measured by cross spectra, and modelled.
# Source: Bendat and Piersol, *Random Data*, 4th ed. 2010, ch. 7 and 9 (spectra of several inputs, multiple coherence).

SEGMENT = 10.0  # s, of the spectra; halves overlap
DRAWS = 200  # of the parameters, for the band of the modelled response
Combination = tuple[tuple[str, float], ...]
"""Channels with their factors, as one parameter multiplies them."""


def frequency_responses(flights: Flights, dynamics: LinearDynamics, fit: FrequencyFit) -> tuple[FrequencyResponse, ...]:
    """Responses of every recorded output to every input of the card, in the band of `fit`."""
    # Channels that one parameter multiplies together, as both ailerons, are one input. Spectra are of segments of
    # `SEGMENT` s (or half of the shortest manoeuvre) of all manoeuvres.
    terms: dict[tuple[int, str], list[tuple[str, float]]] = {}  # what a parameter multiplies: no state, no constant
    for i, (_, row) in enumerate(dynamics.rows.rows):
        for term in row:
            if term.channel not in (ONE, *dynamics.states):
                terms.setdefault((i, term.parameter), []).append((term.channel, term.factor))
    whole = dict.fromkeys(tuple(sorted(product)) for product in terms.values())
    inputs = list(dict.fromkeys(((product[0][0], 1.0),) if len(product) == 1 else product for product in whole))
    outputs = tuple(name for name in dynamics.outputs if name in flights.channels)
    if not inputs or not outputs:
        return ()
    channels = {name: np.asarray(x, float) for name, x in flights.channels.items()}
    u = np.stack([sum(f * channels[name] for name, f in product) for product in inputs])
    y = np.stack([channels[name] for name in outputs])
    frequency, measured, error, coherence = _measured(flights, u, y)
    inside = (frequency >= fit.band[0]) & (frequency <= fit.band[1])
    frequency, measured, error, coherence = (x[inside] for x in (frequency, measured, error, coherence))
    places = [dynamics.names.index(name) for name in fit.names]
    theta = np.array([p.start for p in dynamics.free])
    theta[places] = fit.estimate
    draws = np.tile(theta, (DRAWS, 1))
    draws[:, places] = np.random.default_rng(0).multivariate_normal(fit.estimate, fit.corrected, DRAWS)
    modelled = _modelled(flights, dynamics, inputs, outputs, frequency, np.vstack([theta, draws]))
    return tuple(
        FrequencyResponse(
            " and ".join(name for name, _ in product),
            output,
            frequency,
            measured[:, o, i],
            error[:, o, i],
            coherence[:, o],
            modelled[0, :, o, i],
            modelled[1:, :, o, i],
        )
        for i, product in enumerate(inputs)
        for o, output in enumerate(outputs)
    )


def _measured(
    flights: Flights, u: Float[np.ndarray, "i n"], y: Float[np.ndarray, "o n"]
) -> tuple[Float[np.ndarray, " f"], Complex[np.ndarray, "f o i"], Float[np.ndarray, "f o i"], Float[np.ndarray, "f o"]]:
    dt = float(np.asarray(flights.channels["dt"])[0])
    size = min(round(SEGMENT / dt), min(flights.lengths) // 2)
    both, total = np.concatenate([u, y]), 0.0
    frequency = np.zeros(0)
    for part in np.split(both, np.cumsum(flights.lengths)[:-1], axis=1):
        frequency, spectra = csd(part[:, None], part[None], fs=1.0 / dt, nperseg=size, detrend="linear")
        total = total + part.shape[1] * np.moveaxis(spectra, 2, 0)  # f, first (conjugate), second
    k = len(u)
    S = np.asarray(total)
    tiny = np.finfo(float).tiny
    S_uu, S_uy = S[:, :k, :k], S[:, :k, k:]  # mean of conj(u) u', of conj(u) y'
    inverse = np.linalg.pinv(S_uu, rcond=1e-8, hermitian=True)
    H = np.swapaxes(inverse @ S_uy, 1, 2)
    explained = np.real(np.einsum("foi,fio->fo", np.conj(H), S_uy))
    power = np.real(np.einsum("foo->fo", S[:, k:, k:]))
    left = np.maximum(power - explained, 0.0)  # its mean over the independent segments, of which inputs take k
    segments = sum(2.0 * n / size - 1.0 for n in flights.lengths)
    power_share = np.real(np.einsum("fii->fi", inverse))
    error = np.sqrt(left[:, :, None] * power_share[:, None, :] / max(segments - k, 1.0))
    return frequency, H, error, np.clip(explained / np.maximum(power, tiny), 0.0, 1.0)


def _modelled(
    flights: Flights,
    dynamics: LinearDynamics,
    inputs: list[Combination],
    outputs: tuple[str, ...],
    frequency: Float[np.ndarray, " f"],
    thetas: Float[np.ndarray, "d k"],
) -> Complex[np.ndarray, "d f o i"]:
    """C (j w - A)^-1 B + D of each parameter vector; the delay of an output is a phase."""
    s, w = len(dynamics.states), 2j * np.pi * frequency
    late = dynamics.delays(outputs)

    def one(theta: Float[Array, " k"]) -> Array:
        values = dynamics.values(theta)
        system = dynamics.system(values, flights.aircraft)
        assert isinstance(system, LinearSystem)
        columns = (*system.inputs_read, ONE)
        # The response to one unit of an input is that of its channels: least squares finds them from their sum.
        shares = np.zeros((len(columns), len(inputs)))
        for i, combination in enumerate(inputs):
            size = sum(f * f for _, f in combination)
            for name, factor in combination:
                shares[columns.index(name), i] = factor / size
        B, D = system.matrix[:s, s:] @ shares, system.matrix[s:, s:] @ shares
        X = jnp.linalg.solve(w[:, None, None] * jnp.eye(s) - system.matrix[:s, :s], B + 0j)
        response = {name: X[:, i] for i, name in enumerate(dynamics.states)}
        for row, name in enumerate(system.read):
            more = jnp.einsum("s,fsi->fi", system.matrix[s + row, :s] + 0j, X) + D[row]
            response[name] = more + response.get(name, 0.0)
        delayed = {name: jnp.exp(-w * values[p])[:, None] for name, p in late.items()}
        return jnp.stack([response[name] * delayed.get(name, 1.0) for name in outputs], axis=1)

    return np.asarray(jax.jit(jax.vmap(one))(jnp.asarray(thetas)))
