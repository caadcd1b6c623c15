"""Diagnose aircraft that nobody here has seen: drawn at random and flown by a simulator that shares no code.

    python benchmarks/other_aircraft.py 29 [--first 0] [--gusts 0.5] [--poor] [--single] [--silent] [--no-process-noise]
        [--out strangers]

Every 29th (with --silent all) has nothing hidden, the others one effect each (`tests/stranger_records.py`): two stalls
(or one) at 20, 25 or 50 Hz with white noise, in knots, degrees, feet and g; in gusts of that deviation, m/s; by poor
recorders that colour the noise, filter and round. One line of OUT/strangers.jsonl each; goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from detectability import standard_scores
from stranger_records import HIDDEN, Recorder, flown

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.reading.read_record import read_record
from bayes_aero.inference.compiled_programs import give_back_memory

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
        found = diagnose(records, card, seed=seed, gains_wanted=False, process_noise=process_noise)
    return {
        "seed": seed,
        "hidden": name,
        "size": size,
        "score": None if name is None else standard_scores(found, {name: {HIDDEN[name][0]: size}}).get(name, 0.0),
        "verdict": found.verdict.value,
        "causes": {c.name: {p: [s.mean, s.sd] for p, s in c.parameters.items()} for c in found.causes},
        "ambiguous": {c.name: c.ambiguous_with for c in found.causes},
        "unexplained": [[u.coefficient, u.channel] for u in found.unknown],
        "seconds": time.perf_counter() - began,
    }


def named_first(row: dict) -> bool:
    """Whether the hidden effect is the first cause."""
    return next(iter(row["causes"]), None) == row["hidden"]


def inside(row: dict) -> bool | None:
    """Whether the 95 % interval of the hidden effect holds its size; None where it is no cause."""
    name = row["hidden"]
    if name not in row["causes"]:
        return None
    mean, sd = row["causes"][name][HIDDEN[name][0]]
    return abs(mean - row["size"]) < 1.96 * sd


def report(rows: list[dict]) -> None:
    """Counts, those of a size that is clear, and a line for each record that is not named alone."""
    silent = [r for r in rows if r["hidden"] is None]
    print(f"nothing hidden: silent {sum(r['verdict'] == 'no_effect' for r in silent)} of {len(silent)}")
    some = [r for r in rows if r["hidden"]]
    first = sum(map(named_first, some))
    alone = sum(list(r["causes"]) == [r["hidden"]] and r["verdict"] == "explained" for r in some)
    held = [x for x in map(inside, some) if x is not None]
    print(f"one effect: named first {first} of {len(some)}, nothing else named or unexplained {alone}")
    clear = [r for r in some if r.get("score", 0.0) >= CLEAR]
    print(f"of at least {CLEAR:g} standard errors: named first {sum(map(named_first, clear))} of {len(clear)}")
    print(f"its 95 % interval holds the size {sum(held)} of {len(held)}")
    for r in some:
        if list(r["causes"]) != [r["hidden"]] or r["verdict"] != "explained":
            size = f"{r['size']:.3g} ({r.get('score', 0.0):.1f})"
            print(f"  seed {r['seed']}: {r['hidden']} {size}: {r['causes']}, unexplained {r['unexplained']}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--gusts", type=float, default=0.0, help="their deviation, m/s")
    parser.add_argument("--poor", action="store_true", help="by recorders that colour, filter and round")
    parser.add_argument("--single", action="store_true", help="one manoeuvre instead of two")
    parser.add_argument("--silent", action="store_true", help="nothing hidden in any of them")
    noise = "search in innovations, with gusts estimated, or not; default: where the records are in gusts"
    parser.add_argument("--process-noise", action=argparse.BooleanOptionalAction, help=noise)
    parser.add_argument("--out", type=Path, default=Path("strangers"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "strangers.jsonl"
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    with path.open("a") as file:
        for seed in range(given.first, given.first + given.count):
            if seed not in {row["seed"] for row in done}:
                flights = 1 if given.single else 2
                done.append(case(seed, given.gusts, given.poor, flights, given.silent, given.process_noise))
                give_back_memory()
                file.write(json.dumps(done[-1]) + "\n")
                file.flush()
    report(done)
