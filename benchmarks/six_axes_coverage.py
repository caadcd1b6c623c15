"""How often the intervals of six coefficients and of flight in six degrees of freedom hold the truth.

    python benchmarks/six_axes_coverage.py run 100 --kind calm --out six_coverage      # goes on where it stopped
    python benchmarks/six_axes_coverage.py run 100 --kind gusts --out six_coverage
    python benchmarks/six_axes_coverage.py run 100 --kind stall --out six_coverage
    python benchmarks/six_axes_coverage.py run 8 --kind coloured --first 36000 --out six_coverage
    python benchmarks/six_axes_coverage.py report --out six_coverage

Aircraft are drawn at random and flown by `tests/stranger_six.py`, which shares no code with the package: elevator,
aileron and rudder inputs, 25 s each at 25 Hz, with white noise of every sensor. The card has the true model. `calm`:
still air. `gusts`: gusts of 1 m/s along each axis. `stall`: a stall and two in bank as well (`lateral_effects.py`),
each half of the wing with a separation point that lags, one of them first. `coloured`: still air, 26 s at 50 Hz, the
noise of every sensor and of the surfaces (.06 deg) half white and half with a time constant of .15 s.

Methods: `coefficients` is maximum likelihood as `identify` does it, with corrected bounds; `trajectories` is output
error as `fly` does it, with corrected bounds; `process noise` is its extended Kalman filter (`gusts`).
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import studies
from lateral_effects import FLOWN as STALLS
from lateral_effects import MODEL, ONCE, card_of, made
from scipy.signal import lfilter
from six_axes import ATTACHED, LATERAL, LONGITUDINAL, NOISE, RECORDED, record
from stranger_six import Plane, Strips, drawn, fly
from studies import Row, rows_of

from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import fit_mle, without_noise_bias
from bayes_aero.jobs import fly as flying
from bayes_aero.jobs.options import FlyOptions
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe

KINDS = ("calm", "gusts", "stall", "coloured")
FIRST = {"calm": 31_000, "gusts": 32_000, "stall": 33_000, "coloured": 34_000}
SURFACES, SLOW = 1e-3, 0.15  # rad, s: noise of the recorded surfaces of `coloured`, and its time constant
GUST = 1.0  # m/s
WING_FIRST = (*MODEL, "wing_asymmetry")


def aircraft(kind: str, rng: np.random.Generator) -> Plane:
    """One at random; each half of the wing of `stall` has a separation point that lags, one of them first."""
    if kind != "stall":
        return drawn(rng, **ATTACHED)
    first = rng.choice([-1.0, 1.0]) * rng.uniform(0.005, 0.02)
    wing = {"alpha_star": rng.uniform(0.2, 0.22), "tau1": rng.uniform(8.0, 16.0), "first": first}
    return made(Strips, drawn(rng, Clp=-0.45, Clbe=-0.11, **wing))


def records(kind: str, plane: Plane, rng: np.random.Generator) -> list[FlightRecord]:
    """The manoeuvres as recorded."""
    gust = GUST if kind == "gusts" else 0.0
    flown = STALLS if kind == "stall" else dict.fromkeys(ONCE, 120.0)
    if kind == "coloured":
        return [coloured(name, fly(plane, name, rng, V=V, dt=0.02, seconds=26.0), rng) for name, V in flown.items()]
    return [
        record(name, fly(plane, "stall_in_bank" if name == "again" else name, rng, V=V, gust=gust), rng)
        for name, V in flown.items()
    ]


def coloured(name: str, flight: dict[str, np.ndarray], rng: np.random.Generator) -> FlightRecord:
    """As recorded with noise half of whose variance is of first order with the time constant `SLOW`."""
    n, keep = len(flight["time"]), np.exp(-(flight["time"][1] - flight["time"][0]) / SLOW)
    shown = {c: flight[c] for c in RECORDED}
    for channel, sd in (NOISE | dict.fromkeys(ONCE, SURFACES)).items():
        slow = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], rng.standard_normal(n + 400))[400:]
        shown[channel] = shown[channel] + sd * np.sqrt(0.5) * (rng.standard_normal(n) + slow)
    shown["thrust"] = shown["thrust_left"] + shown["thrust_right"]
    return FlightRecord.from_arrays(name, flight["time"], shown, "simulated")


def truth(plane: Plane, model: Model) -> dict[str, float]:
    """By parameter; of those alone that the plane has."""
    known = {name: float(getattr(plane, name)) for name in model.names if hasattr(plane, name)}
    if not plane.stalls:
        return known
    return known | {
        "alpha_star": plane.alpha_star - plane.first / 2.0,
        "wing_asymmetry": -plane.first,
        "roll_station": 2.0 * plane.station / plane.b,
        "sideslip_incidence": 2.0 * plane.dihedral,
    }


def case(kind: str, seed: int, *, flights: bool = True) -> Row:
    """One aircraft: truth, estimates and standard errors by method."""
    began, rng = time.perf_counter(), np.random.default_rng(seed)
    plane = aircraft(kind, rng)
    card = card_of(plane, WING_FIRST if kind == "stall" else (*LONGITUDINAL, *LATERAL))
    flown, model = records(kind, plane, rng), Model.from_card(card)
    found = without_noise_bias(fit_mle(model, observe(flown, card, model), seed=0), flown, card, model)
    methods = {"coefficients": _estimates(found.status.name, found.names, found.estimate, found.crb_corrected)}
    if flights and kind != "stall":
        methods |= _trajectories(flown, card, kind == "gusts")
    known = truth(plane, model)
    return {"kind": kind, "seed": seed, "truth": known, "methods": methods, "seconds": time.perf_counter() - began}


def _trajectories(flown: list[FlightRecord], card: Card, gusts: bool) -> Row:
    found = flying.fly(flown, card, FlyOptions(figures=False, process_noise=gusts))
    fit, beside = found.flown.fit, found.process_noise
    names = [p.name for p in fit.parameters]
    methods = {"trajectories": _estimates(fit.status.name, names, fit.estimate, fit.sd_corrected)}
    if beside is not None:
        estimate, sd = zip(*beside.estimates.values(), strict=True)
        met = {name: list(found) for name, found in beside.gusts.items()}
        methods["process noise"] = _estimates(beside.status, beside.estimates, estimate, sd) | {"gusts": met}
    return methods


def _estimates(status: str, names: Iterable[str], estimate: Any, sd: Any) -> Row:
    rows = zip(names, map(float, estimate), map(float, sd), strict=True)
    return {"status": status, "found": {name: [x, s] for name, x, s in rows}}


def report(out: Path) -> None:
    """Shares of the truths inside 95 % intervals, with standard errors over aircraft."""
    for path in sorted(out.glob("*.jsonl")):
        rows = rows_of(path)
        for method in dict.fromkeys(m for row in rows for m in row["methods"]):
            _table(path.stem, method, [(row["truth"], row["methods"].get(method)) for row in rows])


def _table(kind: str, method: str, rows: list[tuple[Row, Row | None]]) -> None:
    tried = [(known, fit) for known, fit in rows if fit is not None]
    good = [(known, f["found"]) for known, f in tried if f["status"].lower().replace("_", " ") == "converged"]
    print(f"\n{kind}, {method}: {len(good)} of {len(tried)} converged")
    if len(good) < 2:
        return
    names = [name for name in good[0][0] if name in good[0][1]]
    off = np.array([[(found[n][0] - known[n]) / found[n][1] for n in names] for known, found in good])
    studies.print_inside(names, np.abs(off) < studies.Z95)
    print("  mean deviation: " + ", ".join(f"{n} {x:+.2f}" for n, x in zip(names, off.mean(axis=0), strict=True)))


if __name__ == "__main__":
    parser = studies.parser_of(__doc__, "six_coverage", ("run", "report"), first=None, count=100)
    parser.add_argument("--kind", choices=KINDS, default="calm")
    parser.add_argument("--no-flights", action="store_true", help="coefficients alone")
    given = parser.parse_args()
    if given.what == "run":
        path, first = given.out / f"{given.kind}.jsonl", FIRST[given.kind] if given.first is None else given.first
        seeds = range(first + len(rows_of(path)), first + given.count)
        cases = {seed: partial(case, given.kind, seed, flights=not given.no_flights) for seed in seeds}
        studies.resumed(path, cases, one_length=True)
    report(given.out)
