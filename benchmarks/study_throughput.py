"""How fast studies are done on 1 and 2 workers.

    python benchmarks/study_throughput.py [--records 100] [--seeds 10] [--rounds 2]

Units are maximum-likelihood fits of simulated stalls of 60 s with coloured noise, each record with several seeds (other
starts): the same study with 1 and 2 workers in turn; all records and seeds on 2 workers. Rates are counted from the
first finished unit to the last.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from bayes_aero.flight.card import read_card
from bayes_aero.jobs.catalogue import known_effects, simulate_file
from bayes_aero.simulate.demo import Request

STUDY = """
records = ["{pattern}"]
one_by_one = true
noise = ["white"]
seeds = {seeds}
options.sample = false
options.gp = false
options.figures = false
options.page = false
"""


class Watched:
    """A run of the program in a process of its own."""

    def __init__(self, folder: Path, study: str, out: str, workers: int, cache: Path) -> None:
        command = [sys.executable, "-m", "bayes_aero", "run", study, "--out", out, "--workers", str(workers)]
        settings = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_COMPILATION", "XLA_"))}
        self.out, began = folder / out, time.time()
        subprocess.run(command, cwd=folder, env=settings | {"BAYES_AERO_CACHE": str(cache)}, check=True)
        self.wall = time.time() - began
        ends = sorted(path.stat().st_mtime for path in self.out.glob("units/*/unit.json"))
        self.count = len(ends)
        self.rate = (len(ends) - 1) / (ends[-1] - ends[0]) if len(ends) > 1 else float("nan")

    def numbers(self) -> dict[str, object]:
        """Every result without its provenance."""
        found = {}
        for path in self.out.glob("units/*/results.json"):
            told = json.loads(path.read_text())
            found[path.parent.name] = {k: x for k, x in told.items() if k not in ("provenance", "seconds")}
        return found


def make(folder: Path, records: int) -> None:
    """Random stalls with coloured noise."""
    (folder / "flights").mkdir()
    card = read_card("attas")
    known = known_effects(card)
    for seed in range(records):
        request = Request({}, "random_stall", "ar1", 1.0, seed, 60.0, 0.04, None, 5200.0)
        simulate_file(request, card, known, folder / "flights" / f"f{seed:03d}.csv")


def main() -> None:
    """Print the three parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--rounds", type=int, default=2)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        began = time.perf_counter()
        make(folder, given.records)
        print(f"{given.records} records simulated in {time.perf_counter() - began:.0f} s", flush=True)
        for name, seeds in (("compare", [0]), ("long", list(range(given.seeds)))):
            (folder / f"{name}.toml").write_text(STUDY.format(pattern="flights/*.csv", seeds=seeds))
        cache = folder / "cache"
        rates: dict[int, list[float]] = {1: [], 2: []}
        numbers = []
        for turn in range(given.rounds):
            for workers in (1, 2) if turn % 2 == 0 else (2, 1):
                run = Watched(folder, "compare.toml", f"compare_{turn}_{workers}", workers, cache)
                rates[workers].append(run.rate)
                numbers.append(run.numbers())
                print(f"{workers} worker(s): {run.rate:.2f} units/s, {run.wall:.0f} s in all", flush=True)
        print(f"2 against 1: {max(rates[2]) / max(rates[1]):.2f} x (best of each)")
        print(f"numbers of all runs the same: {all(found == numbers[0] for found in numbers)}", flush=True)

        run = Watched(folder, "long.toml", "long", 2, cache)
        print(f"{run.count} units on 2 workers: {run.wall:.0f} s, {3600 * run.rate:.0f} units/hour", flush=True)


if __name__ == "__main__":
    main()
