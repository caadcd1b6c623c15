"""How much estimates of the stall model lean on smoothing and differentiation, on records or the simulated manoeuvres.

    python benchmarks/preparation_sensitivity.py [RECORD ...] [--model CARD]

Each preparation forms alpha, beta, V, the rates' derivatives and so CL, CD, Cm anew, and the model is fitted again from
the same start. Printed is by how many of the published preparation's corrected deviations an estimate moves.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy import signal

from bayes_aero.flight.card.card import Card, read_card
from bayes_aero.flight.reading.read_record import read_records
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.derived_channels import with_sums
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Observations, observe
from bayes_aero.physics.coefficients import NAMES, RATES, SMOOTHED, coefficients
from bayes_aero.physics.filters import differentiate, smooth
from bayes_aero.simulate.demo import simulate_stall

Filter = Callable[[np.ndarray, float], np.ndarray]
PUBLISHED = "Spencer, 8th order"


class Preparation(NamedTuple):
    """Two linear filters, of a signal and its sample time in s."""

    smoothed: Filter
    slope: Filter  # of the smoothed signal


def same(x: np.ndarray, _: float) -> np.ndarray:
    return x


def spencer(x: np.ndarray, _: float) -> np.ndarray:
    return np.asarray(smooth(jnp.asarray(x)))


def eighth_order(x: np.ndarray, dt: float) -> np.ndarray:
    return np.asarray(differentiate(jnp.asarray(x), dt))


def second_order(x: np.ndarray, dt: float) -> np.ndarray:
    return np.gradient(x, dt)


def cubic(x: np.ndarray, dt: float, seconds: float, derivative: int = 0) -> np.ndarray:
    """Savitzky and Golay's filter over about so many seconds."""
    length = 2 * round(0.5 * seconds / dt) + 1
    return signal.savgol_filter(x, length, 3, deriv=derivative, delta=dt)


def butterworth(x: np.ndarray, dt: float, hertz: float) -> np.ndarray:
    """Fourth order, forward and backward: no phase."""
    return signal.sosfiltfilt(signal.butter(4, hertz, fs=1.0 / dt, output="sos"), x)


PREPARATIONS = {
    PUBLISHED: Preparation(spencer, eighth_order),
    "none, 8th order": Preparation(same, eighth_order),
    "Spencer, 2nd order": Preparation(spencer, second_order),
    "Spencer twice": Preparation(lambda x, dt: spencer(spencer(x, dt), dt), eighth_order),
    "cubic .6 s": Preparation(partial(cubic, seconds=0.6), eighth_order),
    "cubic 1.2 s": Preparation(partial(cubic, seconds=1.2), eighth_order),
    "cubic 1.2 s, slope too": Preparation(partial(cubic, seconds=1.2), partial(cubic, seconds=1.2, derivative=1)),
    "Butterworth 4 Hz": Preparation(partial(butterworth, hertz=4.0), eighth_order),
    "Butterworth 1.5 Hz": Preparation(partial(butterworth, hertz=1.5), eighth_order),
}


def prepared(records: list[FlightRecord], card: Card, way: Preparation, observations: Observations) -> Observations:
    """The same samples with signals and coefficients formed another way."""
    parts: dict[str, list[np.ndarray]] = {}
    for record in records:
        channels, dt = with_sums(record, card), record.dt
        smoothed = {name: way.smoothed(np.asarray(channels[name]), dt) for name in (*SMOOTHED, *RATES)}
        formed = {name: smoothed[name] for name in SMOOTHED} | {"alpha_dot": way.slope(smoothed["alpha"], dt)}
        formed |= {f"{name}_dot": way.slope(smoothed[name], dt) for name in RATES}
        for name, x in formed.items():
            parts.setdefault(name, []).append(x)
    signals = observations.signals | {name: jnp.asarray(np.concatenate(x)) for name, x in parts.items()}
    measured = jnp.stack(coefficients(signals, observations.aircraft)[:3], axis=-1)
    return eqx.tree_at(lambda o: (o.signals, o.measured), observations, (signals, measured))


def main() -> None:
    """Print the estimates' moves, and what each fit explains."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("records", type=Path, nargs="*")
    parser.add_argument("--model", default="attas")
    given = parser.parse_args()
    card = read_card(given.model)
    model = Model.from_card(card)
    records = (
        read_records(given.records, card.channels)
        if given.records
        else [simulate_stall(i, card=card) for i in range(2)]
    )
    ours = observe(records, card, model)
    fits = {}
    for name, way in PREPARATIONS.items():
        data = prepared(records, card, way, ours)
        if name == PUBLISHED:
            np.testing.assert_allclose(data.measured, ours.measured, atol=1e-10)
        fits[name] = fit_mle(model, data)
    reference = fits[PUBLISHED]
    moves = {n: (fit.estimate - reference.estimate) / reference.crb_corrected for n, fit in fits.items()}
    table = pd.DataFrame(moves, index=list(reference.names)).T.drop(index=PUBLISHED)
    table["largest"] = table.abs().max(axis=1)
    print("moves, in corrected deviations of the published preparation's estimates")
    print(table.to_string(float_format=lambda v: f"{v:.2f}"))
    told = {
        name: {"status": fit.status.name.lower()} | {f"R2 of {k}": fit.fit[k].r2 for k in NAMES}
        for name, fit in fits.items()
    }
    print("\nwhat each fit explains of the coefficients as it forms them")
    print(pd.DataFrame(told).T.to_string(float_format=lambda v: f"{v:.3f}"))


if __name__ == "__main__":
    main()
