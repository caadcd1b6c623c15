"""Frequency responses of a linear card's outputs to its inputs: measured by cross spectra, and modelled.

Source: Bendat and Piersol, *Random Data*, 4th ed. 2010, ch. 7 and 9 (spectra of several inputs, multiple coherence).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float
from scipy.signal import csd

from bayes_aero.dynamics.linear import LinearDynamics, LinearSystem
from bayes_aero.flight.card.linear_table import ONE
from bayes_aero.inference.frequency.result import FrequencyFit, FrequencyResponse
from bayes_aero.model.joined_channels import Flights

SEGMENT = 10.0  # s, of the spectra; halves overlap
DRAWS = 200  # of the parameters, for the band of the modelled response
Combination = tuple[tuple[str, float], ...]
"""Channels with their factors, as one parameter multiplies them."""


def frequency_responses(
    flights: Flights, dynamics: LinearDynamics, fit: FrequencyFit, *, seed: int = 0
) -> tuple[FrequencyResponse, ...]:
    """Responses of every recorded output to every input of the card, in the band of `fit`.

    Channels that one parameter multiplies together, as both ailerons, are one input. Spectra are of segments of
    `SEGMENT` s (or half of the shortest manoeuvre) of all manoeuvres.
    """
    inputs = _inputs(dynamics)
    outputs = tuple(name for name in dynamics.outputs if name in flights.channels)
    if not inputs or not outputs:
        return ()
    channels = {name: np.asarray(x, float) for name, x in flights.channels.items()}
    u = np.stack([sum(f * channels[name] for name, f in one) for one in inputs])
    y = np.stack([channels[name] for name in outputs])
    frequency, measured, error, coherence = _measured(flights, u, y)
    inside = (frequency >= fit.band[0]) & (frequency <= fit.band[1])
    frequency, measured, error, coherence = (x[inside] for x in (frequency, measured, error, coherence))
    places = [dynamics.names.index(name) for name in fit.names]
    theta = np.array([p.start for p in dynamics.free])
    theta[places] = fit.estimate
    draws = np.tile(theta, (DRAWS, 1))
    draws[:, places] = np.random.default_rng(seed).multivariate_normal(fit.estimate, fit.corrected, DRAWS)
    modelled = _modelled(flights, dynamics, inputs, outputs, frequency, np.vstack([theta, draws]))
    return tuple(
        FrequencyResponse(
            " and ".join(name for name, _ in one),
            output,
            frequency,
            measured[:, o, i],
            error[:, o, i],
            coherence[:, o],
            modelled[0, :, o, i],
            modelled[1:, :, o, i],
        )
        for i, one in enumerate(inputs)
        for o, output in enumerate(outputs)
    )


def _inputs(dynamics: LinearDynamics) -> list[Combination]:
    """What the parameters multiply beside states and constants."""
    terms: dict[tuple[int, str], list[tuple[str, float]]] = {}
    for i, (_, row) in enumerate(dynamics.rows.rows):
        for term in row:
            if term.channel != ONE and term.channel not in dynamics.states:
                terms.setdefault((i, term.parameter), []).append((term.channel, term.factor))
    whole = {tuple(sorted(one)): None for one in terms.values()}
    single = {((one[0][0], 1.0),) if len(one) == 1 else one: None for one in whole}
    return list(single)


def _measured(
    flights: Flights, u: Float[np.ndarray, "i n"], y: Float[np.ndarray, "o n"]
) -> tuple[Float[np.ndarray, " f"], Complex[np.ndarray, "f o i"], Float[np.ndarray, "f o i"], Float[np.ndarray, "f o"]]:
    """Frequencies, responses with their standard errors, and the multiple coherence of each output."""
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
    own = np.real(np.einsum("fii->fi", inverse))
    error = np.sqrt(left[:, :, None] * own[:, None, :] / max(segments - k, 1.0))
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
        found = {name: X[:, i] for i, name in enumerate(dynamics.states)}
        for row, name in enumerate(system.read):
            more = jnp.einsum("s,fsi->fi", system.matrix[s + row, :s] + 0j, X) + D[row]
            found[name] = more + found.get(name, 0.0)
        delayed = {name: jnp.exp(-w * values[p])[:, None] for name, p in late.items()}
        return jnp.stack([found[name] * delayed.get(name, 1.0) for name in outputs], axis=1)

    return np.asarray(jax.jit(jax.vmap(one))(jnp.asarray(thetas)))
