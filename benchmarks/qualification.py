"""Whether stated probabilities of passing a tolerance are right: simulated aircraft, flown again and on a next flight.

    python benchmarks/qualification.py [--aircraft 100] [--manoeuvres 3] [--first 0]

Every aircraft is a short period whose derivatives differ from manoeuvre to manoeuvre, with a pitching moment of the
third power and a turbulent inflow that the fitted model lacks, and noise of the sensors. The linear model is fitted by
output error; bands are drawn at random. Each test is then flown 20 times by the true aircraft. The simulator of the
truth shares no code with the package. A row has the tests whose stated probability lies in a range: their mean, and the
share of true flights that pass, with its standard error over aircraft.

`again`: the fitted manoeuvre with its own derivatives. `left out`: a manoeuvre with other derivatives, by the errors of
manoeuvres that were left out. `next flight`: the same, by the scatter of the manoeuvres' own fits where it is used.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import studies
from linear_cards import SHORT_PERIOD, card_of

from bayes_aero.diagnosis.trajectories import FlightNoise, posterior_draws
from bayes_aero.dynamics.flight import linear_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.output_error import fit_output_error
from bayes_aero.model.observations import join
from bayes_aero.qualification import FlightKind
from bayes_aero.qualification.qualify import (
    Uncertain,
    alone_fits,
    errors,
    fits_without,
    hold_out,
    next_parameters,
    qualify,
)

CARD = re.sub(r'(?m)^\w+ = "1"\n', "", SHORT_PERIOD)  # without its constants
CARD += """
[parameters]
Zalpha = { prior = { family = "normal", location = -1.0, scale = 0.5 } }
Zde = { prior = { family = "normal", location = 0.0, scale = 0.1 } }
Malpha = { prior = { family = "normal", location = -3.0, scale = 1.5 } }
Mq = { prior = { family = "normal", location = -1.5, scale = 0.7 } }
Mde = { prior = { family = "normal", location = -3.0, scale = 1.0 } }
"""
TRUTH = {"Zalpha": -0.9, "Zde": -0.06, "Malpha": -2.1, "Mq": -1.3, "Mde": -3.0}
SCATTER = 0.05  # of every derivative between manoeuvres, as a share of it
CUBIC, GUST, MEMORY = -150.0, 0.002, 1.0  # 1/s^2, rad, s: what the model lacks
NOISE = {"alpha": 0.001, "q": 0.001, "az": 0.1}
OUTPUTS, BANDS = ("alpha", "q", "az"), (1.5, 8.0)
DT, N, FINER, FLIGHTS, DRAWS = 0.04, 250, 4, 20, 200
RANGES = ((0.0, 0.05), (0.05, 0.25), (0.25, 0.5), (0.5, 0.75), (0.75, 0.95), (0.95, 1.0))


def command(rng: np.random.Generator) -> np.ndarray:
    """An elevator 3-2-1-1 of random size, step and sign."""
    step, size = rng.uniform(0.3, 0.7), rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.05)
    edges = 1.0 + step * np.cumsum([0, 3, 2, 1, 1])
    t = DT * np.arange(N)
    signs = [1.0, -1.0, 1.0, -1.0]
    return size * sum(s * ((t >= a) & (t < b)) for s, a, b in zip(signs, edges[:-1], edges[1:], strict=True))


def scattered(rng: np.random.Generator) -> dict[str, float]:
    """Derivatives of one manoeuvre."""
    return {name: x * (1.0 + SCATTER * rng.standard_normal()) for name, x in TRUTH.items()}


def flight(k: dict[str, float], de: np.ndarray, rng: np.random.Generator, name: str) -> FlightRecord:
    """The true aircraft, by Euler steps of `DT / FINER`."""
    h, alpha, q, gust = DT / FINER, 0.0, 0.0, GUST * rng.standard_normal()
    kept, rows = np.exp(-h / MEMORY), []
    for i in range(N):
        flow = alpha + gust
        rows.append([flow, q, 90.0 * (k["Zalpha"] * flow + k["Zde"] * de[i])])
        ahead = de[min(i + 1, N - 1)]
        for j in range(FINER):
            u, flow = de[i] + (ahead - de[i]) * j / FINER, alpha + gust
            turn = k["Malpha"] * flow + CUBIC * flow**3 + k["Mq"] * q + k["Mde"] * u
            alpha, q = alpha + h * (k["Zalpha"] * flow + q + k["Zde"] * u), q + h * turn
            gust = kept * gust + GUST * np.sqrt(1.0 - kept**2) * rng.standard_normal()
    made = np.array(rows) + np.array([*NOISE.values()]) * rng.standard_normal((N, 3))
    channels = dict(zip(OUTPUTS, made.T, strict=True)) | {"elevator": de}
    return FlightRecord.from_arrays(name, DT * np.arange(N), channels)


def whole(records: Sequence[FlightRecord], card: Card) -> SegmentTrajectories:
    """Records as whole manoeuvres."""
    assert card.linear is not None
    flights = join(list(records), card, card.linear.inputs)
    return segments(flights, linear_dynamics(card, flights.lengths), outputs=OUTPUTS)


def aircraft(seed: int, manoeuvres: int) -> list[tuple[str, float, float]]:
    """Case, stated probability, and share of true flights that pass, of every test of one aircraft."""
    rng = np.random.default_rng([20, seed])
    card = card_of(CARD)
    inputs, derivatives = [command(rng) for _ in range(manoeuvres)], [scattered(rng) for _ in range(manoeuvres)]
    records = [flight(k, u, rng, f"m{i}") for i, (k, u) in enumerate(zip(derivatives, inputs, strict=True))]
    flown = whole(records, card)
    first = fit_output_error(flown)
    noise = replace(FlightNoise.of(first), parts=None)
    fit = fit_output_error(flown, start=first.estimate, prior_weight=noise.variance_inflation)
    without = fits_without(fit, noise)
    held = hold_out(flown, without, noise.variance_inflation, seed)
    each = alone_fits(fit, without, noise.variance_inflation)
    following = next_parameters(each, noise.variance_inflation, DRAWS, seed)
    draws = posterior_draws(fit, noise.variance_inflation, seed, DRAWS)
    size = np.sqrt(np.mean(np.asarray(held[0] if held else 1.0) ** 2, axis=(0, 1)))
    bands = dict(zip(OUTPUTS, size * np.exp(rng.uniform(np.log(BANDS[0]), np.log(BANDS[1]), 3)), strict=True))
    tests = qualify(flown, flown, Uncertain(fit.estimate, draws, following, held), bands, seed=seed).tests
    limits, passed = np.array([*bands.values()]), {}
    for case, own in ((FlightKind.AGAIN, True), (FlightKind.NEXT, False)):
        truth = [
            whole([flight(k if own else scattered(rng), u, rng, f"m{j}") for j in range(FLIGHTS)], card)
            for k, u in zip(derivatives, inputs, strict=True)
        ]
        inside = [np.all(np.abs(errors(one, fit.estimate)[0]) <= limits, axis=1).mean(axis=0) for one in truth]
        passed[case] = {f"m{i}": dict(zip(OUTPUTS, share, strict=True)) for i, share in enumerate(inside)}
    names = {FlightKind.AGAIN: "again", FlightKind.TEST: "left out", FlightKind.NEXT: "next flight"}
    passed[FlightKind.TEST] = passed[FlightKind.NEXT]
    return [(names[t.kind], t.chance.value, float(passed[t.kind][t.manoeuvre][t.output])) for t in tests]


def main() -> None:
    parser = studies.plain_parser(__doc__)
    parser.add_argument("--aircraft", type=int, default=100)
    parser.add_argument("--manoeuvres", type=int, default=3)
    parser.add_argument("--first", type=int, default=0, help="seed of the first aircraft")
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.aircraft)
    found = [(seed, *one) for seed in seeds for one in aircraft(seed, given.manoeuvres)]
    print("| case | stated | tests | mean stated | passed |\n|---|---|---|---|---|")
    for case in ("again", "left out", "next flight"):
        for low, high in (*RANGES, (0.0, 1.0)):
            rows = [r for r in found if r[1] == case and (low < r[2] <= high or low == r[2] == 0.0)]
            if not rows:
                continue
            by = np.array([np.mean([r[3] - r[2] for r in rows if r[0] == seed]) for seed in {r[0] for r in rows}])
            stated, passed = (float(np.mean([r[i] for r in rows])) for i in (2, 3))
            error = float(np.std(by, ddof=1) / np.sqrt(len(by))) if len(by) > 1 else np.nan
            print(f"| {case} | {low:g} to {high:g} | {len(rows)} | {stated:.3f} | {passed:.3f} ± {error:.3f} |")


if __name__ == "__main__":
    main()
