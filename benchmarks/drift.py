"""Count false alarms and hits of parameters that drift, on flights in gusts by a simulator that shares no code.

    python benchmarks/drift.py 20 [--first 0] [--step 0.001] [--minutes 60] [--out drift]

Each seed is flown twice (`tests/gusty_flight.py`: HFB 320, a minute, gusts of 1.5 and 1.0 m/s): with nothing changing,
and with a step of Cm0 at a time drawn from 15 to 45 s, of either sign. Cm0 and CLa are asked to drift. One line of
OUT/drift.jsonl each; goes on where it stopped. The level is that of the program, 0.05 for both parameters together.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from gusty_flight import gusty_flight

from bayes_aero.flight.card.card import read_card
from bayes_aero.inference.compiled_programs import full_of_programs, give_back_memory
from bayes_aero.jobs.fly import fly

OUTPUTS = "airspeed,alpha,theta,q,ax,az"


def case(seed: int, step: float) -> dict:
    """Fly one seed and ask for drift; a step of 0 is none."""
    rng = np.random.default_rng([seed, 17])
    at, size = float(rng.uniform(15.0, 45.0)), step * float(rng.choice([-1.0, 1.0]))
    change = {"Cm0": lambda t: size * (t > at)} if step else None
    began = time.perf_counter()
    found = fly([gusty_flight(seed, change=change)], read_card("hfb320"), drift="Cm0,CLa", outputs=OUTPUTS)
    row = {"seed": seed, "step": size, "at": at if step else None, "seconds": time.perf_counter() - began}
    drift = None if found.process_noise is None else found.process_noise.drift
    if drift is None:
        return row | {"usable": False, "changed": [], "coloured": []}
    p = {name: [x.ratio, x.p] for name, x in drift.parameters.items()}
    moved = next(iter(drift.parameters["Cm0"].changes.values()))
    row |= {"usable": drift.usable, "changed": drift.changed, "coloured": drift.coloured, "p": p}
    return row | {"size": moved.size, "times": moved.times}


def report(rows: list[dict]) -> None:
    """Counts."""
    silent, steps = ([r for r in rows if bool(r["step"]) is there] for there in (False, True))
    for name, some in (("nothing changes", silent), ("a step", steps)):
        no = sum(not r["usable"] for r in some)
        print(f"{name}: {len(some)} flights, not converged {no}, coloured {sum(bool(r['coloured']) for r in some)}")
    print(f"false alarms: {sum(bool(r['changed']) for r in silent)} of {len(silent)}")
    hit = [r for r in steps if "Cm0" in r["changed"]]
    print(f"step of Cm0 found: {len(hit)} of {len(steps)}")
    print(f"CLa called changed beside it: {sum('CLa' in r['changed'] for r in steps)} of {len(steps)}")
    if hit:
        held = sum(abs(r["size"][0] - r["step"]) < 1.96 * r["size"][1] for r in hit)
        away = np.abs([r["times"][1] - r["at"] for r in hit])
        print(f"95 % interval of the change holds the step: {held} of {len(hit)}")
        print(f"half of the change, from the step: median {np.median(away):.2f} s, largest {away.max():.2f} s")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--step", type=float, default=0.001, help="of Cm0; 0.001 is an elevator 0.04 deg off")
    parser.add_argument("--minutes", type=float, default=np.inf, help="none is begun after")
    parser.add_argument("--out", type=Path, default=Path("drift"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path, until = given.out / "drift.jsonl", time.monotonic() + 60.0 * given.minutes
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    with path.open("a") as file:
        for seed in range(given.first, given.first + given.count):
            for step in (0.0, given.step):
                known = {(row["seed"], bool(row["step"])) for row in done}
                if (seed, bool(step)) not in known and time.monotonic() < until:
                    done.append(json.loads(json.dumps(case(seed, step))))
                    if full_of_programs():
                        give_back_memory()
                    file.write(json.dumps(done[-1]) + "\n")
                    file.flush()
    report(done)
