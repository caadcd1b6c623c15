"""Parameters of a linear card while the record grows: a recursive Fourier transform, and equation error on it.

Every sample is added to the sums of the transform, and nothing else of it is kept. From time to time the equations
j w X = A X + B U are solved for the parameters.

Source: Morelli, "Real-time parameter estimation in the frequency domain", J. Guidance 23 (2000) 812; Jategaonkar,
*Flight Vehicle System Identification*, 2nd ed. 2015, ch. 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float

from bayes_aero.dynamics.linear import LinearDynamics
from bayes_aero.errors import InputError
from bayes_aero.flight.card.linear_table import ONE
from bayes_aero.inference.frequency.fit import cramer_rao, solve
from bayes_aero.inference.frequency.result import RunningEstimates
from bayes_aero.model.joined_channels import Flights

SPACING = 0.04  # Hz, of the published programs
BASELINE = 10  # samples whose mean is taken from all
EVERY = 1.0  # s between solutions


class RunningTransform:
    """Sums x_i exp(-j w i dt) over the samples so far, at fixed frequencies, and the same of derivatives.

    The integral of x' exp(-j w t) over a manoeuvre is j w X and its end minus its begin. `ends` False leaves these out,
    as the published programs do: right where a manoeuvre ends in the trim in which it has begun.
    """

    def __init__(self, frequencies: Float[np.ndarray, " f"], dt: float, columns: int, *, ends: bool = True) -> None:
        """`frequencies` in Hz, `dt` in s, number of signals."""
        self.frequencies, self.dt, self.ends, self.samples = frequencies, dt, ends, 0
        self._sums: Complex[np.ndarray, "f c"] = np.zeros((len(frequencies), columns), complex)
        self._edges, self._last = np.zeros_like(self._sums), np.zeros_like(self._sums)
        self._halves = np.zeros_like(self._sums)

    def add(self, x: Float[np.ndarray, " c"], *, begins: bool) -> None:
        """One more sample of all signals; `begins`: the first one of a manoeuvre."""
        phase = 2.0 * np.pi * self.frequencies * (self.samples * self.dt)
        term = np.exp(-1j * phase)[:, None] * x
        if begins:  # trapezoidal sums count the first and the last sample of a manoeuvre half
            self._edges += self._last - term
            self._halves += 0.5 * (self._last + term)
        self._sums += term
        self._last = term
        self.samples += 1

    def signals(self) -> Complex[np.ndarray, "f c"]:
        """Sums of the signals."""
        return self._sums - (self._halves + 0.5 * self._last) if self.ends else self._sums

    def derivatives(self) -> Complex[np.ndarray, "f c"]:
        """Sums of their derivatives."""
        edges = (self._edges + self._last) / self.dt if self.ends else 0.0
        return 2j * np.pi * self.frequencies[:, None] * self.signals() + edges


@dataclass(frozen=True)
class _Rows:
    """Terms of the rates: `free` (s, k, c) and `fixed` (s, c) multiply the signals, states first."""

    names: tuple[str, ...]
    free: Float[np.ndarray, "s k c"]
    fixed: Float[np.ndarray, "s c"]


def running_estimates(
    flights: Flights, dynamics: LinearDynamics, band: tuple[float, float], *, ends: bool = True
) -> RunningEstimates:
    """Equation error of the rates at frequencies `SPACING` apart in `band` (Hz), every `EVERY` s of the record.

    Manoeuvres follow each other without a pause, less the mean of the first `BASELINE` samples. Standard errors count
    the real and the imaginary part of a line. Before 1/`SPACING` s lines are not independent, and the variances are
    larger by that share. With `ends` (see `RunningTransform`) the constants of the equations are free; without, as in
    the published programs, the first samples have to be in trim.

    Raises:
        InputError: a state was not recorded, or sampling times differ.
    """
    rows = _rows(dynamics)
    signals = (*dynamics.states, *dynamics.inputs)
    unseen = [name for name in signals if name not in flights.channels]
    if unseen:
        raise InputError(f"{unseen[0]} was not recorded, and equation error needs it")
    dt = np.asarray(flights.channels["dt"], float)
    if np.ptp(dt) > 1e-6 * dt[0]:
        raise InputError("the manoeuvres have different sampling times; give --resample")
    x = np.stack([np.asarray(flights.channels[name], float) for name in signals], axis=1)
    x = np.column_stack([x - x[:BASELINE].mean(axis=0), np.ones(len(x))])
    step = max(1, round(EVERY / dt[0]))
    transform = RunningTransform(np.arange(band[0], band[1] + 1e-9, SPACING), float(dt[0]), x.shape[1], ends=ends)
    time, value, sd = [], [], []
    for sample, begins in zip(x, np.asarray(flights.channels["start"]), strict=True):
        transform.add(sample, begins=bool(begins))
        if transform.samples % step == 0:
            estimate, error = estimates_of(transform, rows)
            time.append(transform.samples * transform.dt)
            value.append(estimate)
            sd.append(error)
    units = {p.name: p.unit for p in dynamics.free}
    told = tuple(units[name] for name in rows.names)
    return RunningEstimates(rows.names, told, np.array(time), np.array(value), np.array(sd))


def estimates_of(transform: RunningTransform, rows: _Rows) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Parameters and their standard errors from the sums so far; NaN where they do not determine them."""
    scale = np.sqrt(2.0 / transform.samples)  # white noise keeps its variance
    F, rate = scale * transform.signals(), scale * transform.derivatives()[:, : len(rows.fixed)]
    F, one = F[:, :-1], F[:, -1]
    known, S = rate - F @ rows.fixed.T, np.einsum("fc,skc->fsk", F, rows.free)
    if transform.ends:
        S = np.concatenate([S, one[:, None, None] * np.eye(len(rows.fixed))], axis=2)
    residual, S = (np.concatenate([np.real(part), np.imag(part)]) for part in (known, S))
    found = solve(residual, S)
    _, D = cramer_rao(S, found.R)
    k, overlap = len(rows.names), max(1.0, 1.0 / (SPACING * transform.samples * transform.dt))
    if not np.all(np.isfinite(D)):
        return np.full(k, np.nan), np.full(k, np.nan)
    return found.step[:k], np.sqrt(overlap * np.diag(D)[:k])


def _rows(dynamics: LinearDynamics) -> _Rows:
    """The rates' terms but constants."""
    signals, card = (*dynamics.states, *dynamics.inputs), dynamics.rows
    moving = [(i, t) for i, row in enumerate(card.rates) for t in row if t.channel != ONE]
    names = tuple(dict.fromkeys(t.parameter for _, t in moving if t.parameter not in dynamics.fixed))
    free = np.zeros((len(card.rates), len(names), len(signals)))
    fixed = np.zeros((len(card.rates), len(signals)))
    for i, term in moving:
        c = signals.index(term.channel)
        if term.parameter in dynamics.fixed:
            fixed[i, c] += term.factor * dynamics.fixed[term.parameter]
        else:
            free[i, names.index(term.parameter), c] += term.factor
    return _Rows(names, free, fixed)
