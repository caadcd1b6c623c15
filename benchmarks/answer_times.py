"""Seconds until a command answers and until it ends, with an empty cache of programs and again: medians of three.

python benchmarks/answer_times.py STALL STALL --manoeuvre FILE CARD     # the ATTAS stalls, one short manoeuvre
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory


def timed(command: list[str], folder: Path) -> tuple[float, float]:
    """Seconds to the first line of the answer, and to the end."""
    began, first = time.perf_counter(), float("nan")
    environment = os.environ | {"BAYES_AERO_CACHE": str(folder / "cache")}
    with subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True) as running:
        for line in running.stdout or ():
            if line.startswith("Record "):
                first = time.perf_counter() - began
    return first, time.perf_counter() - began


def measured(command: list[str], times: int) -> list[float]:
    """First answer and end, cold, then again."""
    rows = []
    for _ in range(times):
        with TemporaryDirectory() as folder:
            rows.append([x for _ in ("cold", "again") for x in timed(command, Path(folder))])
    return [median(column) for column in zip(*rows, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("records", nargs="+", type=Path)
    parser.add_argument("--model", default="attas")
    parser.add_argument("--manoeuvre", nargs=2, default=None, metavar=("FILE", "CARD"))
    parser.add_argument("--times", type=int, default=3)
    given = parser.parse_args()
    program, stalls = str(Path(sys.executable).with_name("bayes-aero")), [str(r.resolve()) for r in given.records]
    commands = {
        "check": ["check", *stalls, "--model", given.model],
        "identify --no-gp": ["identify", *stalls, "--model", given.model, "--no-gp"],
        "diagnose": ["diagnose", *stalls, "--model", given.model],
    }
    if given.manoeuvre is not None:
        file, card = given.manoeuvre
        commands["fly"] = ["fly", str(Path(file).resolve()), "--model", card]
    print(f"{'command':18s}{'first cold':>12s}{'all cold':>10s}{'first again':>13s}{'all again':>11s}")
    for name, command in commands.items():
        a, b, c, d = measured([program, *command], given.times)
        print(f"{name:18s}{a:12.1f}{b:10.1f}{c:13.1f}{d:11.1f}", flush=True)


if __name__ == "__main__":
    main()
