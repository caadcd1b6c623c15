"""How time and memory grow with the length of a record and with the number of manoeuvres.

    OPENBLAS_NUM_THREADS=1 python benchmarks/scaling.py [samples] [manoeuvres]

Every row is a process of its own, so that its peak memory is its own. Compilation is counted apart: what a second fit
of the same shape takes is `again`. Exponents are of a power law between neighbouring rows: 1 is linear.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

SAMPLES = (2_000, 20_000, 200_000)
MANOEUVRES = (5, 50, 500)


def long_record(n: int, seed: int = 0):
    """A simulated stall flown again and again, each time with other noise: 25 Hz."""
    from bayes_aero.flight.record import FlightRecord
    from bayes_aero.simulate.demo import simulate_stall

    base = simulate_stall(0, sensor_noise=0.0, disturbance=0.0)
    rng = np.random.default_rng(seed)
    deviation = {name: 0.02 * np.std(x) for name, x in base.channels.items()}
    there_and_back = {k: np.concatenate([x, x[::-1]]) for k, x in base.channels.items()}  # no jump at the seams
    channels = {k: np.resize(x, n) + deviation[k] * rng.standard_normal(n) for k, x in there_and_back.items()}
    return FlightRecord.from_arrays(f"long_{seed}", np.arange(n) * base.dt, channels)


def samples(n: int) -> dict[str, float]:
    """Read a CSV file and fit."""
    from bayes_aero.flight.card import read_card
    from bayes_aero.flight.reading import read_record
    from bayes_aero.flight.record import write_record

    card, times = read_card("attas"), {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "record.csv"
        record = long_record(n)
        write_record(record, path, [c for c in card.channels if record.has(c.name)])
        times["MB"] = path.stat().st_size / 1e6
        record = timed(times, "read", lambda: read_record(path, card.channels))
    return fitted([record], times)


def manoeuvres(count: int) -> dict[str, float]:
    """One joint fit of manoeuvres of 500 to 1000 samples, hardly two of one length."""
    rng = np.random.default_rng(0)
    whole = [long_record(4000, seed) for seed in range(10)]
    records = []
    for k in range(count):
        record, first, length = whole[k % 10], int(rng.integers(0, 3000)), int(rng.integers(500, 1000))
        channels = {name: x[first : first + length] for name, x in record.channels.items()}
        records.append(type(record).from_arrays(f"m{k}", record.time[:length], channels))
    return fitted(records, {"samples": float(sum(r.n for r in records))})


def fitted(records: list, times: dict[str, float]) -> dict[str, float]:
    """Coefficients formed, and two fits."""
    from bayes_aero.flight.card import read_card
    from bayes_aero.inference.mle import fit_mle
    from bayes_aero.model.model import Model
    from bayes_aero.model.observations import observe

    card = read_card("attas")
    model = Model.from_card(card)
    observations = timed(times, "observe", lambda: observe(records, card, model))
    for name in ("mle", "again"):
        timed(times, name, lambda: fit_mle(model, observations, extra_starts=0))
    return times


def timed(times: dict[str, float], name: str, do: Callable[[], Any]) -> Any:
    """Its result; its processor time of all threads into `times`: other work on the machine counts little."""
    began = time.process_time()
    found = do()
    times[name] = time.process_time() - began
    return found


KINDS = {"samples": (samples, SAMPLES), "manoeuvres": (manoeuvres, MANOEUVRES)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=["samples", "manoeuvres"])
    parser.add_argument("--one", nargs=2)
    parser.add_argument("--sizes", type=int, nargs="*")
    options = parser.parse_args()
    if options.one:
        kind, size = options.one
        found = KINDS[kind][0](int(size))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
        print(json.dumps(found | {"GiB": peak}))
        return
    for kind in options.kinds:
        before: dict[str, float] = {}
        for size in options.sizes or KINDS[kind][1]:
            command = [sys.executable, __file__, "--one", kind, str(size)]
            done = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True)
            row = json.loads(done.stdout.splitlines()[-1]) | {"size": size}
            grown = size / before.get("size", size)
            power = {k: math.log(x / before[k]) / math.log(grown) if grown > 1.0 else 0.0 for k, x in row.items()}
            print(f"{kind}:", ", ".join(f"{k} {x:.3g} ({power[k]:.2f})" for k, x in row.items()), flush=True)
            before = row


if __name__ == "__main__":
    main()
