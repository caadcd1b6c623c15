"""Seconds until a command answers and until it ends, with an empty cache of programs and again: medians of three.

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
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

COMPILED = re.compile(r"Finished XLA compilation of (?:jit\()?([^ )]+)\)? in ([0-9.]+) sec")


def run(command: list[str], folder: Path, **more: str) -> tuple[float, float, str]:
    """Seconds to the answer's first line and to the end, and the standard error."""
    began, first = time.perf_counter(), float("nan")
    environment, log = os.environ | {"BAYES_AERO_CACHE": str(folder / "cache")} | more, folder / "log"
    options = {"cwd": folder, "env": environment, "stdout": subprocess.PIPE, "text": True}
    with log.open("w") as errors, subprocess.Popen(command, stderr=errors, **options) as running:
        for line in running.stdout or ():
            if line.startswith("Record "):
                first = time.perf_counter() - began
    return first, time.perf_counter() - began, log.read_text()


def measured(command: list[str], times: int) -> list[float]:
    """First answer and end, cold, then again."""
    rows = []
    for _ in range(times):
        with TemporaryDirectory() as folder:
            rows.append([x for _ in ("cold", "again") for x in run(command, Path(folder))[:2]])
    return [median(column) for column in zip(*rows, strict=True)]


def programs(name: str, command: list[str]) -> None:
    """How many a command compiles, and which take longest."""
    seconds = defaultdict[str, float](float)
    with TemporaryDirectory() as folder:
        made = COMPILED.findall(run(command, Path(folder), JAX_LOG_COMPILES="1")[2])
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
    print(f"{'command':18s}{'first cold':>12s}{'all cold':>10s}{'first again':>13s}{'all again':>11s}")
    for name, command in commands.items():
        a, b, c, d = measured([program, *command], given.times)
        print(f"{name:18s}{a:12.1f}{b:10.1f}{c:13.1f}{d:11.1f}", flush=True)


if __name__ == "__main__":
    main()
