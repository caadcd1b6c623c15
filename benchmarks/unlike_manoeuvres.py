"""Diagnose flights of two or three unlike standard manoeuvres, with an effect hidden in them or none.

    python benchmarks/unlike_manoeuvres.py 60 [--first 0] [--silent] [--before] [--out unlike]

A doublet does not predict a stall, so that what is left out of such flights says little of what an effect gains. Each
flight draws an effect of the catalogue (`--silent`: none), its size and the manoeuvres, simulated with coloured
disturbances and sensor noise. `--before`: without the gain of additions by themselves (`transferred_deviance_gain`).
One line of OUT/hidden.jsonl, or silent, each; goes on where it stopped.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import numpy as np
from next_test_points import CARD, flown, open_to_rivals, told
from resumed import resumed

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.selection import cross_validation
from bayes_aero.errors import InputError
from bayes_aero.simulate.injection import draw_hidden

KINDS = ("slow_stall", "elevator_3211", "thrust_steps", "speed_change", "bank_to_bank", "elevator_doublet")


def case(seed: int, silent: bool) -> dict:
    """Draw, fly and diagnose."""
    rng = np.random.default_rng([seed, 83])
    kinds = [str(k) for k in rng.choice(KINDS, int(rng.integers(2, 4)), replace=False)]
    name = str(rng.choice(open_to_rivals()))
    effects = {} if silent else {name: draw_hidden(rng, name)}
    row = {"seed": seed, "hidden": effects, "kinds": kinds}
    try:
        records = [flown(effects, 100 * seed + k, kind, manoeuvre=kind) for k, kind in enumerate(kinds)]
    except InputError as error:
        return row | {"refused": str(error)}
    return row | told(diagnose(records, CARD, seed=seed, gains_wanted=False, process_noise=False))


def report(rows: list[dict], silent: bool) -> None:
    """Counts, then what each flight said."""
    tried = [r for r in rows if "refused" not in r]
    if silent:
        quiet = sum(not r["causes"] and not r["unexplained"] for r in tried)
        print(f"nothing hidden: no finding in {quiet} of {len(tried)}")
    else:
        first = [r for r in tried if next(iter(r["causes"]), None) in r["hidden"]]
        named = [r for r in tried if set(r["hidden"]) & set(r["causes"])]
        sets = [r for r in tried if any(set(r["hidden"]) & set(x) for x in r["ambiguous"].values())]
        false = [r for r in tried if r["causes"] and r not in named and r not in sets]
        print(f"{len(tried)} flights: named {len(named)}, first {len(first)}, among the rivals of a cause {len(sets)}")
        print(f"only another cause {len(false)}; unexplained {sum(bool(r['unexplained']) for r in tried)}")
    for r in tried:
        print(f"  {r['seed']} {r['hidden']} {r['kinds']}: {r['verdict']} {list(r['causes'])} {r['unexplained']}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--silent", action="store_true")
    parser.add_argument("--before", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("unlike"))
    given = parser.parse_args()
    if given.before:
        cross_validation.transferred_deviance_gain = lambda *_: -1.0
    name = f"{'silent' if given.silent else 'hidden'}{'_before' if given.before else ''}.jsonl"
    seeds = range(given.first, given.first + given.count)
    report(resumed(given.out / name, {seed: partial(case, seed, given.silent) for seed in seeds}), given.silent)
