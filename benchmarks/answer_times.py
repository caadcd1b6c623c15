"""Seconds until a command says what the record is worth, answers and ends; with no programs kept, and again. Medians.

python benchmarks/answer_times.py STALL STALL --manoeuvre FILE CARD     # the ATTAS stalls, one short manoeuvre
python benchmarks/answer_times.py STALL STALL --programs     # compiled by each command, with an empty cache
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import time
from collections import defaultdict
from math import nan
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

COMPILED = re.compile(r"Finished XLA compilation of (?:jit\()?([^ )]+)\)? in ([0-9.]+) sec")


def run(command: list[str], folder: Path, **more: str) -> tuple[list[float], str]:
    """Seconds to the record's first line, to that of the result, and to the end; the standard error."""
    began, said = time.perf_counter(), dict[str, float]()
    environment, log = os.environ | {"BAYES_AERO_CACHE": str(folder / "cache")} | more, folder / "log"
    options = {"cwd": folder, "env": environment, "stdout": subprocess.PIPE, "text": True}
    with log.open("w") as errors, subprocess.Popen(command, stderr=errors, **options) as running:
        for line in running.stdout or ():
            said.setdefault(line[:7], time.perf_counter() - began)
    return [said.get("Record ", nan), said.get("Result ", nan), time.perf_counter() - began], log.read_text()


def measured(command: list[str], times: int) -> list[float]:
    """Record, answer and end, cold, then again."""
    rows = []
    for _ in range(times):
        with TemporaryDirectory() as folder:
            rows.append([x for _ in ("cold", "again") for x in run(command, Path(folder))[0]])
    return [median(column) for column in zip(*rows, strict=True)]


def programs(name: str, command: list[str]) -> None:
    """How many a command compiles, and which take longest."""
    seconds = defaultdict[str, float](float)
    with TemporaryDirectory() as folder:
        made = COMPILED.findall(run(command, Path(folder), JAX_LOG_COMPILES="1")[1])
    for program, spent in made:
        seconds[program] += float(spent)
    longest = ", ".join(f"{p} {x:.1f}" for p, x in sorted(seconds.items(), key=lambda row: -row[1])[:6])
    print(f"{name}: {len(made)} programs, {sum(seconds.values()):.1f} s to compile ({longest})", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("records", nargs="+", type=Path)
    parser.add_argument("--model", default="attas")
    parser.add_argument("--manoeuvre", nargs=2, default=None, metavar=("FILE", "CARD"))
    parser.add_argument("--times", type=int, default=3)
    parser.add_argument("--programs", action="store_true")
    given = parser.parse_args()
    program, stalls = str(Path(sys.executable).with_name("bayes-aero")), [str(r.resolve()) for r in given.records]
    commands = {"check": ["check"], "identify --no-gp": ["identify", "--no-gp"], "diagnose": ["diagnose"]}
    commands = {name: [*command, *stalls, "--model", given.model] for name, command in commands.items()}
    if given.manoeuvre is not None:
        file, card = given.manoeuvre
        commands["fly"] = ["fly", str(Path(file).resolve()), "--model", card]
    if given.programs:
        for name, command in commands.items():
            programs(name, [program, *command])
        return
    print(f"{'cold, then again':18s}" + 2 * f"{'record':>9s}{'answer':>9s}{'all':>9s}")
    for name, command in commands.items():
        row = measured([program, *command], given.times)
        print(f"{name:18s}" + "".join(f"{x:9.1f}" for x in row), flush=True)


if __name__ == "__main__":
    main()
