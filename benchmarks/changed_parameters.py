"""A parameter that changes halfway through a record: is it found, when, of what size; and how often without a change.

python benchmarks/changed_parameters.py silence 60 --first 100     # nothing changes, 90 s pairs
python benchmarks/changed_parameters.py change 20 --first 500      # Cm0 or CLaM changes in the second manoeuvre
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from studies import parser_of, seeds_of

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from out_of_catalogue import AT, changed

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.simulate.injection import hidden_records

NOISES = ("white", "ar1", "ar1", "buffet", "outliers")
SIZES = {"Cm0": (0.003, 0.012), "CLaM": (0.6, 2.0)}  # of a change, uniform in its logarithm, of either sign


def flown(seed: int, change: bool) -> tuple[list[FlightRecord], str, float]:
    """Records, the parameter that changes, and by how much."""
    rng = np.random.default_rng([seed, 99])
    noise = str(rng.choice(NOISES))
    if not change:
        return hidden_records({}, seed=seed, noise=noise, seconds=90.0), "", 0.0
    name = str(rng.choice(sorted(SIZES)))
    size = float(np.exp(rng.uniform(*np.log(SIZES[name]))) * rng.choice([-1.0, 1.0]))
    return changed(name, size, seed=seed, noise=noise, seconds=90.0), name, size


def main() -> None:
    """Fly, diagnose, print a line each and the counts."""
    parser = parser_of(__doc__, kinds=("silence", "change"))
    asked = parser.parse_args()
    card, rows = read_card("attas"), []
    for seed in seeds_of(asked):
        records, name, size = flown(seed, asked.what == "change")
        began = time.perf_counter()
        found = diagnose(records, card, seed=seed, settings=DiagnosisSettings(gains=False))
        seconds = time.perf_counter() - began
        first = next(iter(found.changes), None)
        right = first is not None and name in (first.parameter, *first.ambiguous_with)
        rows.append((bool(found.changes), found.verdict.value != "no_effect", right, first, name, size))
        told = [f"{c.parameter} {c.manoeuvre} {c.at:.1f} s {c.size[0]:.4g} ± {c.size[1]:.2g}" for c in found.changes]
        others = [*(c.name for c in found.causes), *(f"{u.coefficient} over {u.channel}" for u in found.unknown)]
        print(f"{seed} {name} {size:.4g}: changes {told}, others {others}, {seconds:.1f} s", flush=True)
    print(f"a change is claimed in {sum(r[0] for r in rows)} of {len(rows)}, anything in {sum(r[1] for r in rows)}")
    right = [(first, size) for _, _, ok, first, name, size in rows if ok and first.parameter == name]
    if right:
        inside = sum(first.interval[0] <= AT <= first.interval[1] for first, _ in right)
        z = np.array([(first.size[0] - size) / first.size[1] for first, size in right])
        print(f"the parameter that changed is first or a rival of the first in {sum(r[2] for r in rows)}; first in")
        print(f"  {len(right)}: time inside {inside}, size within 1.96 standard errors {sum(abs(z) < 1.96)}")


if __name__ == "__main__":
    main()
