"""Diagnose aircraft that nobody here has seen: drawn at random and flown by a simulator that shares no code.

    python benchmarks/other_aircraft.py 29 [--first 0] [--gusts 0.5] [--poor] [--single] [--silent] [--no-process-noise]
        [--out strangers]

Every 29th (with --silent all) has nothing hidden, the others one effect each (`tests/stranger.py`): two stalls
(or one) at 20, 25 or 50 Hz with white noise, in knots, degrees, feet and g; in gusts of that deviation, m/s; by poor
recorders that colour the noise, filter and round. One line of OUT/strangers.jsonl each; goes on where it stopped.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from studies import alone, parser_of, print_silent, print_sizes, run_seeds, standard_scores, told

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from stranger import HIDDEN, Recorder, flown

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.flight.card import read_card
from bayes_aero.flight.reading import read_record

CLEAR = 6.0  # standard errors of the first screening


def case(seed: int, gusts: float, poor: bool, manoeuvres: int, silent: bool, process_noise: bool | None = None) -> dict:
    """Draw, fly, read and diagnose."""
    name = None if silent else [None, *HIDDEN][seed % (len(HIDDEN) + 1)]
    recorder = Recorder.poor(np.random.default_rng([seed, 13])) if poor else Recorder()
    with tempfile.TemporaryDirectory() as folder:
        _, size, files = flown(Path(folder), np.random.default_rng([seed, 12]), name, gusts, recorder, manoeuvres)
        card = read_card(str(Path(folder) / "card.toml"))
        records = [read_record(path, card.channels) for path in files]
        began = time.perf_counter()
        found = diagnose(records, card, seed=seed, settings=DiagnosisSettings(gains=False, process_noise=process_noise))
    return {
        "seed": seed,
        "hidden": name,
        "size": size,
        "score": None if name is None else standard_scores(found, {name: {HIDDEN[name][0]: size}}).get(name, 0.0),
        **told(found, began),
    }


def named_first(row: dict) -> bool:
    """Whether the hidden effect is the first cause."""
    return next(iter(row["causes"]), None) == row["hidden"]


def inside(row: dict) -> bool | None:
    """Whether the 95 % interval of the hidden effect holds its size; None where it is no cause."""
    found = sized(row)
    return None if found is None else abs(found[0] - row["size"]) < 1.96 * found[1]


def sized(row: dict) -> tuple[float, float, float] | None:
    """Size found of the hidden effect with its deviation, and the true one; None where it is no cause."""
    name = row["hidden"]
    return (*row["causes"][name][HIDDEN[name][0]], row["size"]) if name in row["causes"] else None


def report(rows: list[dict]) -> None:
    """Counts, and those of a size that is clear."""
    print_silent([r for r in rows if r["hidden"] is None])
    some = [r for r in rows if r["hidden"]]
    print(f"one effect: named first {sum(map(named_first, some))} of {len(some)}, "
          f"nothing else named or unexplained {sum(map(alone, some))}")  # fmt: skip
    clear = [r for r in some if r.get("score", 0.0) >= CLEAR]
    print(f"of at least {CLEAR:g} standard errors: named first {sum(map(named_first, clear))} of {len(clear)}")
    print_sizes([x for x in map(sized, some) if x is not None])


def main() -> None:
    """Fly, and report."""
    parser = parser_of(__doc__, "strangers")
    parser.add_argument("--gusts", type=float, default=0.0, help="their deviation, m/s")
    parser.add_argument("--poor", action="store_true", help="by recorders that colour, filter and round")
    parser.add_argument("--single", action="store_true", help="one manoeuvre instead of two")
    parser.add_argument("--silent", action="store_true", help="nothing hidden in any of them")
    noise = "search in innovations, with gusts estimated, or not; default: where the records are in gusts"
    parser.add_argument("--process-noise", action=argparse.BooleanOptionalAction, help=noise)
    given = parser.parse_args()
    settings = {name: getattr(given, name) for name in ("gusts", "poor", "silent", "process_noise")}
    report(run_seeds(given, "strangers.jsonl", case, manoeuvres=1 if given.single else 2, **settings))


if __name__ == "__main__":
    main()
