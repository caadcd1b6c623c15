"""How the cost of six coefficients grows with the samples of the record and with the catalogue.

    OPENBLAS_NUM_THREADS=1 python benchmarks/six_axes_cost.py [--book ../shared/book] [--picture FILE]

Simulated manoeuvres of `full_six` (3-2-1-1, doublets of aileron and rudder), warm, best of some calls in turn. `fit` is
maximum likelihood of the coefficients with corrected bounds, `flight` the simulation in six degrees of freedom with
its derivatives by all parameters and initial states, `catalogue` the derivatives of all residuals by the parameters of
a share of the catalogue. Exponents are of a power law between neighbouring rows: 1 is linear. With the book's data
also the fit of TC23.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rigid_body_speed import KINDS, ours

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.segments import segments
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card.card import Card, read_card
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.physics.coefficient_names import required_of
from bayes_aero.residuals.equation_error import EquationError
from bayes_aero.simulate.request import Request
from bayes_aero.simulate.synthetic_record import synthetic

SAMPLES = (1000, 4000, 16000)  # of all manoeuvres together
SHARES = (0.25, 0.5, 1.0)  # of the catalogue
REPEATS = 5
Row = tuple[float, float]  # size, seconds


def seconds_of(calls: Sequence[Callable[[], Any]]) -> list[float]:
    """Of the fastest of some calls of each, in turn; the first, which may compile, is not counted."""
    found: list[list[float]] = [[] for _ in calls]
    for repeat in range(REPEATS + 1):
        for call, times in zip(calls, found, strict=True):
            begin = time.perf_counter()
            jax.block_until_ready(call())
            if repeat:
                times.append(time.perf_counter() - begin)
    return [min(times) for times in found]


def records(card: Card) -> list[FlightRecord]:
    """Three manoeuvres."""
    asked = [Request({}, kind, "white", seed=seed, duration=28.0) for seed, kind in enumerate(KINDS)]
    return [synthetic(one, card, CATALOGUE, one.manoeuvre).record for one in asked]


def of_length(flown: Sequence[FlightRecord], n: int) -> list[FlightRecord]:
    """Each flown there and back again until it has a third of `n` samples: no jump at the seams."""
    found = []
    for record in flown:
        both = {name: np.concatenate([x, x[::-1]]) for name, x in record.channels.items()}
        channels = {name: np.resize(x, n // 3) for name, x in both.items()}
        found.append(FlightRecord.from_arrays(record.name, record.dt * np.arange(n // 3), channels))
    return found


def fits(card: Card, flown: Sequence[FlightRecord]) -> list[Row]:
    """Maximum likelihood by number of samples."""
    model = Model.from_card(card)
    made = [observe(of_length(flown, n), card, model) for n in SAMPLES]
    return list(zip(SAMPLES, seconds_of([lambda o=o: fit_mle(model, o, extra_starts=0) for o in made]), strict=True))


def simulations(card: Card, flown: Sequence[FlightRecord]) -> list[Row]:
    """Simulation with derivatives by number of samples; what is flown need not be the record."""
    calls = []
    for n in SAMPLES:
        flights = join(of_length(flown, n), card, ())
        dynamics = aircraft_dynamics(Model.from_card(card), flights)
        cut = jax.tree.map(jnp.asarray, segments(flights, dynamics).nameless)
        theta = jnp.array([p.start for p in dynamics.free])
        calls.append(lambda cut=cut, theta=theta: ours(cut, theta))
    return list(zip(SAMPLES, seconds_of(calls), strict=True))


def catalogues(card: Card, flown: Sequence[FlightRecord]) -> list[Row]:
    """Derivatives of residuals by number of the catalogue's parameters."""
    flights = join(flown, card, required_of(card.axes))
    full = candidate_model(Model.from_card(card), flights)
    responses = EquationError.of(flights, full.model)
    theta = full.neutral_vector
    mixed = np.random.default_rng(0).permutation(len(theta))
    counts = [round(share * len(theta)) for share in SHARES]
    calls = [lambda c=c: responses.linearise(theta, np.sort(mixed[:c])) for c in counts]
    return list(zip(map(float, counts), seconds_of(calls), strict=True))


def published(folder: Path) -> None:
    """The fit of TC23: 2128 samples, 20 parameters."""
    card = read_card("full_six")
    flown = [read_record(folder / f"fAttas{name}.mat", card.channels) for name in ("Elv1", "Ail1", "Rud1")]
    model = Model.from_card(card)
    made = observe(flown, card, model, "published")
    (taken,) = seconds_of([lambda: fit_mle(model, made, extra_starts=0)])
    print(f"TC23, {sum(r.n for r in flown)} samples, {len(model.names)} parameters: {1e3 * taken:.0f} ms")


def table(what: str, unit: str, rows: Sequence[Row]) -> None:
    """Seconds and exponents."""
    before = None
    for size, taken in rows:
        power = "" if before is None else f" (exponent {math.log(taken / before[1]) / math.log(size / before[0]):.2f})"
        print(f"{what}, {size:.0f} {unit}: {1e3 * taken:.1f} ms{power}")
        before = size, taken


def picture(path: Path, curves: dict[str, list[Row]]) -> None:
    """Time over size, both relative to the first row, and the line of proportion."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(5.5, 3.6), layout="constrained")
    for name, rows in curves.items():
        size, taken = np.array(rows).T
        axes.loglog(size / size[0], taken / taken[0], "o-", label=name)
    axes.loglog([1, 16], [1, 16], "k:", label="proportional")
    axes.set(xlabel="size, relative to the smallest", ylabel="time, relative to it")
    axes.legend(frameon=False)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Print, and draw where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--book", type=Path)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    card = read_card("full_six")
    flown = records(card)
    curves = {
        "fit of six coefficients, samples": fits(card, flown),
        "flight with derivatives, samples": simulations(card, flown),
        "catalogue, parameters": catalogues(card, flown),
    }
    for name, rows in curves.items():
        table(*name.split(", "), rows)
    if given.book is not None:
        published(given.book)
    if given.picture is not None:
        picture(given.picture, curves)


if __name__ == "__main__":
    main()
