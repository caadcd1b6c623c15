"""How fast studies are done on 1 and 2 workers, what the cache of programs saves, what a worker's memory does.

    python benchmarks/study_throughput.py [--records 100] [--seeds 10] [--rounds 2] [--drill]

Units are maximum-likelihood fits of simulated stalls of 60 s with coloured noise, each record with several seeds (other
starts). Three parts: the first unit of a worker with an empty and with a filled cache; the same study with 1 and 2
workers in turn; all records and seeds on 2 workers, with a worker killed half-way if --drill is given, which is then
compared with the study that nobody disturbed. Rates are counted from the first finished unit to the last.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil

from bayes_aero.flight.card.card import read_card
from bayes_aero.jobs.catalogue.known_effects import known_effects
from bayes_aero.jobs.simulated_truth import simulate_file
from bayes_aero.simulate.request import Request

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
    """A run of the program in a process of its own, its workers' memory seen every second."""

    def __init__(self, folder: Path, study: str, out: str, workers: int, cache: Path, kill_after: int = 0) -> None:
        command = [sys.executable, "-m", "bayes_aero", "run", study, "--out", out, "--workers", str(workers)]
        settings = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_COMPILATION", "XLA_"))}
        self.out, self.memory, self.killed = folder / out, [], not kill_after
        began = time.time()
        with subprocess.Popen(command, cwd=folder, env=settings | {"BAYES_AERO_CACHE": str(cache)}) as process:
            watch = threading.Thread(target=self._watch, args=(psutil.Process(process.pid), kill_after), daemon=True)
            watch.start()
            self.code = process.wait()
        self.wall = time.time() - began
        ends = sorted(path.stat().st_mtime for path in self.out.glob("units/*/unit.json"))
        self.count = len(ends)
        self.rate = (len(ends) - 1) / (ends[-1] - ends[0]) if len(ends) > 1 else float("nan")

    def _watch(self, driver: psutil.Process, kill_after: int) -> None:
        while driver.is_running():
            try:
                found = [p for p in driver.children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]
                sizes = {p.pid: p.memory_info().rss / 2**20 for p in found}
            except psutil.Error:
                sizes = {}
            if sizes:
                done = len(list(self.out.glob("units/[!.]*")))
                self.memory.append((done, sizes, driver.memory_info().rss / 2**20))
                if not self.killed and done >= kill_after:
                    os.kill(min(sizes), signal.SIGKILL)
                    self.killed = True
            time.sleep(1.0)

    def largest(self, share: float) -> float:
        """MiB of the largest worker until a share of the units was done."""
        return max(max(sizes.values()) for done, sizes, _ in self.memory if done <= share * self.count)

    def seconds(self) -> list[float]:
        """What units took, in the order in which they ended."""
        with (self.out / "units.csv").open(newline="") as handle:
            rows = {row["unit"]: float(row["seconds"]) for row in csv.DictReader(handle)}
        ends = sorted(self.out.glob("units/*/unit.json"), key=lambda path: path.stat().st_mtime)
        return [rows[path.parent.name] for path in ends]

    def numbers(self) -> dict[str, object]:
        """Every result without its provenance."""
        found = {}
        for path in self.out.glob("units/*/results.json"):
            told = json.loads(path.read_text())
            found[path.parent.name] = {
                key: value for key, value in told.items() if key not in ("provenance", "seconds")
            }
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
    parser.add_argument("--drill", action="store_true", help="kill a worker of the long study half-way")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        began = time.perf_counter()
        make(folder, given.records)
        print(f"{given.records} records simulated in {time.perf_counter() - began:.0f} s", flush=True)
        seeds = list(range(given.seeds))
        for name, pattern, chosen in (
            ("few", "flights/f00[0-3].csv", [0]),
            ("compare", "flights/*.csv", [0]),
            ("long", "flights/*.csv", seeds),
        ):
            (folder / f"{name}.toml").write_text(STUDY.format(pattern=pattern, seeds=chosen))
        cache = folder / "cache"
        for state in ("empty", "filled"):
            run = Watched(folder, "few.toml", f"few_{state}", 1, cache)
            print(f"cache {state}: units took {', '.join(f'{x:.1f}' for x in run.seconds())} s", flush=True)

        rates: dict[int, list[float]] = {1: [], 2: []}
        numbers = []
        for turn in range(given.rounds):
            for workers in (1, 2) if turn % 2 == 0 else (2, 1):
                run = Watched(folder, "compare.toml", f"compare_{turn}_{workers}", workers, cache)
                rates[workers].append(run.rate)
                numbers.append(run.numbers())
                print(f"{workers} worker(s): {run.rate:.2f} units/s, {run.wall:.0f} s in all", flush=True)
        best = {workers: max(found) for workers, found in rates.items()}
        mean = {workers: float(np.mean(found)) for workers, found in rates.items()}
        print(f"2 against 1: {best[2] / best[1]:.2f} x (best of each), {mean[2] / mean[1]:.2f} x (mean)")
        print(f"numbers of all runs the same: {all(found == numbers[0] for found in numbers)}", flush=True)

        run = Watched(folder, "long.toml", "long", 2, cache)
        whole, steady = 3600 * run.count / run.wall, 3600 * run.rate
        print(f"{run.count} units on 2 workers: {run.wall:.0f} s, {whole:.0f} units/hour with start and end")
        print(f"{steady:.0f} units/hour from the first to the last", flush=True)
        shares = (0.02, 0.1, 0.25, 0.5, 0.75, 1.0)
        print("largest worker, MiB: " + ", ".join(f"{run.largest(s):.0f} until {s:.0%}" for s in shares))
        print(f"driver, MiB: {max(driver for _, _, driver in run.memory):.0f}", flush=True)
        if given.drill:
            again = Watched(folder, "long.toml", "drill", 2, cache, kill_after=run.count // 2)
            same = again.numbers() == run.numbers()
            print(
                f"with a worker killed half-way: exit status {again.code}, {again.wall:.0f} s, numbers the same: {same}"
            )


if __name__ == "__main__":
    main()
