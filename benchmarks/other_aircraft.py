"""Diagnose aircraft that nobody here has seen: drawn at random and flown by a simulator that shares no code.

    python benchmarks/other_aircraft.py 29 [--first 0] [--gusts 0.5] [--poor] [--single] [--silent] [--no-process-noise]
        [--out strangers]

Every 29th (with --silent all) has nothing hidden, the others one effect each (`tests/stranger.py`): two stalls
(or one) at 20, 25 or 50 Hz with white noise, in knots, degrees, feet and g; in gusts of that deviation, m/s; by poor
recorders that colour the noise, filter and round. One line of OUT/strangers.jsonl each; goes on where it stopped.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import studies
from stranger import HIDDEN, Recorder, flown
from studies import CLEAR, Row, alone, hidden, named_first, share

from bayes_aero.flight.card import read_card
from bayes_aero.flight.reading import read_record


def case(seed: int, gusts: float, poor: bool, manoeuvres: int, silent: bool, process_noise: bool | None = None) -> Row:
    """Draw, fly, read and diagnose."""
    name = None if silent else [None, *HIDDEN][seed % (len(HIDDEN) + 1)]
    recorder = Recorder.poor(np.random.default_rng([seed, 13])) if poor else Recorder()
    with tempfile.TemporaryDirectory() as folder:
        _, size, files = flown(Path(folder), np.random.default_rng([seed, 12]), name, gusts, recorder, manoeuvres)
        card = read_card(str(Path(folder) / "card.toml"))
        records = [read_record(path, card.channels) for path in files]
        found, row = studies.diagnosed(records, card, seed, process_noise=process_noise)
    effects = {} if name is None else {name: {HIDDEN[name][0]: size}}
    return {"seed": seed, "hidden": effects, "scores": studies.standard_scores(found, effects), **row}


def report(rows: list[Row]) -> None:
    """Counts, and those of a size that is clear."""
    studies.print_silent([r for r in rows if not r["hidden"]])
    some = [r for r in rows if r["hidden"]]
    print(f"one effect: named first {share(map(named_first, some))}, "
          f"nothing else named or unexplained {share(map(alone, some))}")  # fmt: skip
    clear = [r for r in some if r["scores"].get(hidden(r), 0.0) >= CLEAR]
    print(f"of at least {CLEAR:g} standard errors: named first {share(map(named_first, clear))}")
    studies.print_sizes(some)


if __name__ == "__main__":
    parser = studies.parser_of(__doc__, "strangers")
    parser.add_argument("--gusts", type=float, default=0.0, help="their deviation, m/s")
    parser.add_argument("--poor", action="store_true", help="by recorders that colour, filter and round")
    parser.add_argument("--single", action="store_true", help="one manoeuvre instead of two")
    parser.add_argument("--silent", action="store_true", help="nothing hidden in any of them")
    noise = "search in innovations, with gusts estimated, or not; default: where the records are in gusts"
    parser.add_argument("--process-noise", action=argparse.BooleanOptionalAction, help=noise)
    given = parser.parse_args()
    settings = {name: getattr(given, name) for name in ("gusts", "poor", "silent", "process_noise")}
    report(studies.run_seeds(given, "strangers.jsonl", case, manoeuvres=1 if given.single else 2, **settings))
