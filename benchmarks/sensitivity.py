"""How much estimates of the stall model lean on priors and on preparation, on records or the simulated manoeuvres.

    python benchmarks/sensitivity.py priors [RECORD ...] [--model CARD]
    python benchmarks/sensitivity.py preparation [RECORD ...] [--model CARD]

`priors`: power-scaling of the posterior. `preparation`: each way forms alpha, beta, V, the rates' derivatives and so
CL, CD, Cm anew, and the model is fitted again from the same start; printed is by how many of the published
preparation's corrected deviations an estimate moves.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pandas as pd
from scipy import signal

from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.reading import read_records
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.sampling import density_start, find_mode, sample_ensemble
from bayes_aero.inference.validation import prior_sensitivity
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Density, Noise
from bayes_aero.model.observations import Observations, observe
from bayes_aero.model.records import with_sums
from bayes_aero.physics.coefficients import SMOOTHED, coefficients
from bayes_aero.physics.filters import differentiate, smooth
from bayes_aero.physics.kinematics import RATES
from bayes_aero.simulate.demo import demo_records

Filter = Callable[[np.ndarray, float], np.ndarray]
PUBLISHED = "Spencer, 8th order"


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


PREPARATIONS: dict[str, tuple[Filter, Filter]] = {  # of a signal and its sample time; its slope when filtered
    PUBLISHED: (spencer, eighth_order),
    "none, 8th order": (same, eighth_order),
    "Spencer, 2nd order": (spencer, second_order),
    "Spencer twice": (lambda x, dt: spencer(spencer(x, dt), dt), eighth_order),
    "cubic .6 s": (partial(cubic, seconds=0.6), eighth_order),
    "cubic 1.2 s": (partial(cubic, seconds=1.2), eighth_order),
    "cubic 1.2 s, slope too": (partial(cubic, seconds=1.2), partial(cubic, seconds=1.2, derivative=1)),
    "Butterworth 4 Hz": (partial(butterworth, hertz=4.0), eighth_order),
    "Butterworth 1.5 Hz": (partial(butterworth, hertz=1.5), eighth_order),
}


def prepared(
    records: list[FlightRecord], card: Card, way: tuple[Filter, Filter], observations: Observations
) -> Observations:
    """The same samples with signals and coefficients formed another way."""
    filtered, slope = way
    parts: dict[str, list[np.ndarray]] = {}
    for record in records:
        channels, dt = with_sums(record, card), record.dt
        smoothed = {name: filtered(np.asarray(channels[name]), dt) for name in (*SMOOTHED, *RATES)}
        formed = {name: smoothed[name] for name in SMOOTHED} | {"alpha_dot": slope(smoothed["alpha"], dt)}
        formed |= {f"{name}_dot": slope(smoothed[name], dt) for name in RATES}
        for name, x in formed.items():
            parts.setdefault(name, []).append(x)
    signals = observations.signals | {name: jnp.asarray(np.concatenate(x)) for name, x in parts.items()}
    measured = jnp.stack(coefficients(signals, observations.aircraft)[:3], axis=-1)
    return eqx.tree_at(lambda o: (o.signals, o.measured), observations, (signals, measured))


def preparations(records: list[FlightRecord], card: Card, model: Model) -> None:
    """Print the estimates' moves."""
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


def priors(records: list[FlightRecord], card: Card, model: Model) -> None:
    """Print the power-scaling of every parameter."""
    observations = observe(records, card, model)
    mle = fit_mle(model, observations)
    for colour in (Colour.AR1, Colour.WHITE):
        density = Density.of(observations, model, Noise(colour))
        posterior = sample_ensemble(density, find_mode(density, density_start(density, mle)), predictive=False)
        print(f"\n{colour.value} noise, {posterior.status.value}")
        print(prior_sensitivity(density, posterior).to_string(float_format=lambda v: f"{v:.3f}"))


def main() -> None:
    """One of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("priors", "preparation"))
    parser.add_argument("records", type=Path, nargs="*")
    parser.add_argument("--model", default="attas")
    given = parser.parse_args()
    card = read_card(given.model)
    records = read_records(given.records, card.channels) if given.records else demo_records()
    {"priors": priors, "preparation": preparations}[given.what](records, card, Model.from_card(card))


if __name__ == "__main__":
    main()
