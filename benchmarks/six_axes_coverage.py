"""How often the intervals of six coefficients and of flight in six degrees of freedom hold the truth.

    python benchmarks/six_axes_coverage.py run 100 --kind calm --out six_coverage      # goes on where it stopped
    python benchmarks/six_axes_coverage.py run 100 --kind gusts --out six_coverage
    python benchmarks/six_axes_coverage.py run 100 --kind stall --out six_coverage
    python benchmarks/six_axes_coverage.py run 8 --kind coloured --first 36000 --out six_coverage
    python benchmarks/six_axes_coverage.py report --out six_coverage

Aircraft are drawn at random and flown by `tests/stranger_six.py`, which shares no code with the package: elevator,
aileron and rudder inputs, 25 s each at 25 Hz, with white noise of every sensor. The card has the true model. `calm`:
still air. `gusts`: gusts of 1 m/s along each axis. `stall`: a stall and two in bank as well (`wing_first.py`), each
half of the wing with a separation point that lags, one of which stalls first. `coloured`: still air, 26 s at 50 Hz,
the noise of every sensor and of the surfaces (.06 deg) half white and half with a time constant of .15 s.

Methods: `coefficients` is maximum likelihood as `identify` does it, with corrected bounds; `trajectories` is output
error as `fly` does it, with corrected bounds; `process noise` is its extended Kalman filter (`gusts`).
"""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter
from studies import Z95, mean_and_error, parser_of, resumed, rows_of

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import six_axes
from stranger_six import Plane, Strips, drawn, fly
from wing_first import EFFECTS, card_of
from wing_first import FLOWN as STALLS

from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.mle import fit_mle, without_noise_bias
from bayes_aero.jobs import fly as flying
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe

KINDS = ("calm", "gusts", "stall", "coloured")
FIRST = {"calm": 31_000, "gusts": 32_000, "stall": 33_000, "coloured": 34_000}
SURFACES, SLOW = 1e-3, 0.15  # rad, s: noise of the recorded surfaces of `coloured`, and its time constant
GUST = 1.0  # m/s
WING_FIRST = (*EFFECTS, "wing_asymmetry")


def aircraft(kind: str, rng: np.random.Generator) -> Plane:
    """One at random; each half of the wing of `stall` has a separation point that lags, one of them first."""
    if kind != "stall":
        return drawn(rng, **six_axes.ATTACHED)
    first = rng.choice([-1.0, 1.0]) * rng.uniform(0.005, 0.02)
    wing = {"alpha_star": rng.uniform(0.2, 0.22), "tau1": rng.uniform(8.0, 16.0), "first": first}
    plane = drawn(rng, Clp=-0.45, Clbe=-0.11, **wing)
    return Strips(**{name: getattr(plane, name) for name in Plane.__dataclass_fields__})


def records(kind: str, plane: Plane, rng: np.random.Generator) -> list[FlightRecord]:
    """The manoeuvres as recorded."""
    gust = GUST if kind == "gusts" else 0.0
    flown = STALLS if kind == "stall" else dict.fromkeys(("elevator", "aileron", "rudder"), 120.0)
    if kind == "coloured":
        return [coloured(name, fly(plane, name, rng, V=V, dt=0.02, seconds=26.0), rng) for name, V in flown.items()]
    return [
        six_axes.record(name, fly(plane, "stall_in_bank" if name == "again" else name, rng, V=V, gust=gust), rng)
        for name, V in flown.items()
    ]


def coloured(name: str, flight: dict[str, np.ndarray], rng: np.random.Generator) -> FlightRecord:
    """As recorded with noise half of whose variance is of first order with the time constant `SLOW`."""
    n, keep = len(flight["time"]), np.exp(-(flight["time"][1] - flight["time"][0]) / SLOW)
    shown = {c: flight[c] for c in six_axes.RECORDED}
    for channel, sd in (six_axes.NOISE | dict.fromkeys(("elevator", "aileron", "rudder"), SURFACES)).items():
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


def case(kind: str, seed: int, *, flights: bool = True) -> dict[str, Any]:
    """One aircraft: truth, estimates and standard errors by method."""
    began, rng = time.perf_counter(), np.random.default_rng(seed)
    plane = aircraft(kind, rng)
    effects = WING_FIRST if kind == "stall" else (*six_axes.LONGITUDINAL, *six_axes.LATERAL)
    card = card_of(plane, effects)
    flown, model = records(kind, plane, rng), Model.from_card(card)
    methods = {"coefficients": _coefficients(flown, card, model)}
    if flights and kind != "stall":
        methods |= _trajectories(flown, card, kind == "gusts")
    known = truth(plane, model)
    return {"kind": kind, "seed": seed, "truth": known, "methods": methods, "seconds": time.perf_counter() - began}


def _coefficients(flown: list[FlightRecord], card: Card, model: Model) -> dict[str, Any]:
    found = fit_mle(model, observe(flown, card, model), seed=0)
    found = without_noise_bias(found, flown, card, model)
    sd = found.crb_corrected
    return {"status": found.status.name, **_pairs(found.names, found.estimate, sd)}


def _trajectories(flown: list[FlightRecord], card: Card, gusts: bool) -> dict[str, Any]:
    found = flying.fly(flown, card, figures=False, process_noise=gusts)
    fit, names = found.flown.fit, [p.name for p in found.flown.fit.parameters]
    methods = {"trajectories": {"status": fit.status.name, **_pairs(names, fit.estimate, fit.sd_corrected)}}
    if found.process_noise is not None:
        beside = found.process_noise
        estimates = beside.estimates
        pairs = _pairs(estimates, [x for x, _ in estimates.values()], [s for _, s in estimates.values()])
        gusts = {name: list(found) for name, found in beside.gusts.items()}
        methods["process noise"] = {"status": beside.status, "gusts": gusts, **pairs}
    return methods


def _pairs(names: Any, estimate: Any, sd: Any) -> dict[str, dict[str, float]]:
    return {
        "estimate": {n: float(x) for n, x in zip(names, estimate, strict=True)},
        "sd": {n: float(x) for n, x in zip(names, sd, strict=True)},
    }


def run(kind: str, count: int, out: Path, first: int, *, flights: bool) -> None:
    """Until there are `count` of this kind, from the seed `first`, a line each in OUT/KIND.jsonl."""
    path = out / f"{kind}.jsonl"
    done = len(rows_of(path))
    cases = {seed: partial(case, kind, seed, flights=flights) for seed in range(first + done, first + count)}
    resumed(path, cases, one_length=True)


def report(out: Path) -> None:
    """Shares of the truths inside 95 % intervals, with standard errors over aircraft."""
    for path in sorted(out.glob("*.jsonl")):
        rows = rows_of(path)
        for method in dict.fromkeys(m for row in rows for m in row["methods"]):
            _table(path.stem, method, [row for row in rows if method in row["methods"]])


def _table(kind: str, method: str, rows: list[dict[str, Any]]) -> None:
    good = [row for row in rows if row["methods"][method]["status"].lower().replace("_", " ") == "converged"]
    print(f"\n{kind}, {method}: {len(good)} of {len(rows)} converged")
    if len(good) < 2:
        return
    names = [n for n in good[0]["truth"] if n in good[0]["methods"][method]["estimate"]]
    found = {k: np.array([[row["methods"][method][k][n] for n in names] for row in good]) for k in ("estimate", "sd")}
    off = (found["estimate"] - np.array([[row["truth"][n] for n in names] for row in good])) / found["sd"]
    inside = np.abs(off) < Z95
    print("  inside 95 %: {:.3f} +- {:.3f}".format(*mean_and_error(inside.mean(axis=1))))
    print("  " + ", ".join(f"{n} {x:.2f}" for n, x in zip(names, inside.mean(axis=0), strict=True)))
    print("  mean deviation: " + ", ".join(f"{n} {x:+.2f}" for n, x in zip(names, off.mean(axis=0), strict=True)))


if __name__ == "__main__":
    parser = parser_of(__doc__, "six_coverage", ("run", "report"), first=None, count=100)
    parser.add_argument("--kind", choices=KINDS, default="calm")
    parser.add_argument("--no-flights", action="store_true", help="coefficients alone")
    given = parser.parse_args()
    if given.what == "run":
        first = FIRST[given.kind] if given.first is None else given.first
        run(given.kind, given.count, given.out, first, flights=not given.no_flights)
    report(given.out)
