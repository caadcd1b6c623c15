"""Fly flights of fresh seeds, and hold the rates that the documentation claims against exact binomial bounds.

    python benchmarks/verify.py                    # rounds for ten minutes on two cores (make verify)
    python benchmarks/verify.py --full             # 70 rounds with posteriors: hours
    python benchmarks/verify.py --rounds 3 --minutes 5 --workers 1

A round has flights of six kinds: nothing hidden, one effect, an effect of no catalogue; another simulator's aircraft
with one effect and without; a pair of stalls for `identify`. Seeds are drawn anew and printed. Every flight is one line
of OUT/<first seed>/flights.jsonl. At the end, or where it is interrupted, one line is added to the ledger, whatever the
verdict. Exit status 1: a claim is refuted, or a flight crashed.

A claim is refuted where its rate lies outside the Clopper-Pearson limits of the count at `LEVEL`: exactly where the
exact binomial test of that rate, to the side from which the claim can fail, has a p-value below 1 - `LEVEL`.

Source: C. J. Clopper and E. S. Pearson, Biometrika 26, 1934, 404-413.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import secrets
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, ProcessPoolExecutor, wait
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import beta

import bayes_aero

HERE = Path(__file__).resolve().parent
LEDGER = HERE / "ledger.csv"
SEEDS = (1_000_000, 30_000_000)  # among which the first is drawn; the documentation's are below
FULL = 70  # rounds
APART = 1_000_000  # between the seeds of two kinds
LEVEL = 0.99
# Flights of one round, on which the claims are tried. Another simulator's records differ in length and rate: each
# compiles anew, and takes as long as the others together.
ROUND = {"silence": 3, "one": 3, "identify": 4, "unknown": 1, "other": 1, "other_silence": 1}

Row = Mapping[str, Any]
Case = Callable[[str, int, bool], Row]


class Side(StrEnum):
    """How the true rate may differ from the claimed one."""

    AT_MOST = "at most"
    AT_LEAST = "at least"
    EQUAL = "equal to"


@dataclass(frozen=True)
class Claim:
    """The true rate of `text` is `side` `rate`; `key` is its column of the ledger."""

    key: str
    text: str
    side: Side
    rate: float

    def limits(self, hits: int, of: int) -> tuple[float, float]:
        """Exact limits of the true rate at `LEVEL`, given `hits` of `of` independent trials.

        One-sided (the other limit is 0 or 1) unless the claim is an equality; (0, 1) without trials.
        """
        tail = (1.0 - LEVEL) / (2.0 if self.side is Side.EQUAL else 1.0)
        low = float(beta.ppf(tail, hits, of - hits + 1)) if hits > 0 and self.side is not Side.AT_LEAST else 0.0
        high = float(beta.ppf(1.0 - tail, hits + 1, of - hits)) if hits < of and self.side is not Side.AT_MOST else 1.0
        return low, high

    def holds(self, hits: int, of: int) -> bool:
        """Whether the count is consistent with the claim."""
        low, high = self.limits(hits, of)
        return low <= self.rate <= high

    def bound(self, hits: int, of: int) -> str:
        """The limits in words of the ledger."""
        low, high = self.limits(hits, of)
        if self.side is Side.EQUAL:
            return f"{low:.4f} to {high:.4f}"
        return f">= {low:.4f}" if self.side is Side.AT_MOST else f"<= {high:.4f}"


# The rates are those that the documentation states or implies; benchmarks/README.md says where.
CLAIMS = (
    Claim("false_alarms", "nothing hidden: anything named or called unexplained", Side.AT_MOST, 0.05),
    Claim("named", "one effect of at least 6 standard errors: first or in the ambiguity set", Side.AT_LEAST, 0.97),
    Claim("size_held", "its 95 % interval holds its size", Side.AT_LEAST, 0.95),
    Claim("unexplained", "an effect of no catalogue: called unexplained", Side.AT_LEAST, 0.90),
    Claim("other_false_alarms", "another simulator's aircraft, nothing hidden: any finding", Side.AT_MOST, 0.05),
    Claim("other_named", "another simulator's aircraft, one effect: named first", Side.AT_LEAST, 0.95),
    Claim("other_size_held", "another simulator's aircraft: the 95 % interval holds the size", Side.AT_LEAST, 0.84),
    Claim("bound_held", "corrected 95 % bounds of identify hold a parameter drawn at random", Side.EQUAL, 0.95),
    Claim("posterior_held", "95 % posterior intervals of identify hold the same parameter", Side.EQUAL, 0.95),
)


@dataclass(frozen=True)
class Run:
    """Code, rounds, whether posteriors are sampled, and the first seed."""

    commit: str
    rounds: int
    posterior: bool
    first: int

    def jobs(self) -> Iterator[tuple[str, int, bool]]:
        """Kind, seed and whether to sample, round by round."""
        for number in range(self.rounds):
            for kind, flights_each in ROUND.items():
                for k in range(number * flights_each, (number + 1) * flights_each):
                    yield kind, self.first + k, self.posterior


def commit_of(folder: Path) -> str:
    """The commit of the code, with `+changes` where tracked files but the ledger differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=folder, capture_output=True, text=True, check=True).stdout.strip()

    try:
        paths = (":/", ":(top,exclude)benchmarks/ledger.csv")
        changed = git("status", "--porcelain", "--untracked-files=no", "--", *paths)
        return git("rev-parse", "--short=10", "HEAD") + ("+changes" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def fly(run: Run, folder: Path, case: Case, pool: Executor, workers: int, seconds: float, rows: list[Row]) -> list[Row]:
    """Fly all of the run, into `rows`; none is begun after `seconds`."""
    jobs, deadline, pending = run.jobs(), time.monotonic() + seconds, set()
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "flights.jsonl").open("a") as file:
        while True:
            while len(pending) < workers and time.monotonic() < deadline and (job := next(jobs, None)):
                pending.add(pool.submit(case, *job))
            if not pending:
                return rows
            ended, pending = wait(pending, return_when=FIRST_COMPLETED)
            for row in (future.result() for future in ended):
                file.write(json.dumps(row) + "\n")
                file.flush()
                rows.append(row)
                print(f"{row['kind']:14s} {row['seed']}: {_said(row)}", flush=True)


def _said(row: Row) -> str:
    for word in ("refused", "crashed"):
        if word in row:
            return f"{word}: {row[word]}"
    return ", ".join(f"{key} {'yes' if hit else 'no'}" for key, hit in row["trials"].items()) or "too small to count"


def count(rows: Sequence[Row]) -> dict[str, tuple[int, int]]:
    """Hits and trials of each claim."""
    each = {claim.key: [row["trials"][claim.key] for row in rows if claim.key in row["trials"]] for claim in CLAIMS}
    return {key: (sum(hits), len(hits)) for key, hits in each.items()}


def line_of(run: Run, rows: Sequence[Row]) -> dict[str, str]:
    """The run as a line of the ledger."""
    counts, crashed = count(rows), sum("crashed" in row for row in rows)
    refuted = [claim.key for claim in CLAIMS if not claim.holds(*counts[claim.key])]
    faults = [*refuted, *([f"{crashed} crashed"] if crashed else [])]
    seeds = [row["seed"] for row in rows]
    line = {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "version": bayes_aero.__version__,
        "commit": run.commit,
        "seeds": f"{min(seeds, default=run.first)} to {max(seeds, default=run.first)}",
        "flights": str(len(rows)),
        "refused": str(sum("refused" in row for row in rows)),
        "verdict": "not refuted" if not faults else f"refuted: {', '.join(faults)}",
    }
    for claim in CLAIMS:
        hits, of = counts[claim.key]
        line |= {claim.key: f"{hits}/{of}", f"{claim.key}_99": claim.bound(hits, of) if of else ""}
    return line


def enter(line: Mapping[str, str], ledger: Path) -> None:
    """Add a line; a column that the ledger lacks is added behind the others."""
    old = [pd.read_csv(ledger, dtype=str, keep_default_na=False)] if ledger.exists() else []
    pd.concat([*old, pd.DataFrame([line])], ignore_index=True).fillna("").to_csv(ledger, index=False)


def report(rows: Sequence[Row]) -> None:
    """Counts, bounds and verdicts."""
    counts = count(rows)
    for claim in CLAIMS:
        hits, of = counts[claim.key]
        if of:
            verdict = "not refuted" if claim.holds(hits, of) else "REFUTED"
            print(f"{claim.text}: {hits} of {of}; claimed {claim.side} {claim.rate:g}; "
                  f"{LEVEL:.0%} bound {claim.bound(hits, of)}; {verdict}")  # fmt: skip
        else:
            print(f"{claim.text}: not tried")


def case(kind: str, seed: int, posterior: bool) -> Row:
    """Trials (claim: hit or not) of one flight, and all that was found in it.

    `refused`: the aircraft cannot be flown so, which is no trial. `crashed`: anything else that went wrong.
    """
    from bayes_aero.errors import InputError  # a worker alone loads the numerics

    row: dict[str, Any] = {"kind": kind, "seed": seed, "trials": {}}
    try:
        found, trials = _of(kind, seed + APART * list(ROUND).index(kind), posterior)
    except InputError as error:
        return row | {"refused": str(error)}
    except Exception as error:
        return row | {"crashed": f"{type(error).__name__}: {error}", "traceback": traceback.format_exc()}
    return row | {"trials": trials, "found": found}


def _of(kind: str, seed: int, posterior: bool) -> tuple[Row, dict[str, bool]]:
    import hidden_effects
    import other_aircraft
    import studies

    if kind == "identify":
        return _identified(seed, posterior)
    if kind in ("other", "other_silence"):
        found = other_aircraft.case(seed, 0.0, bool(seed % 2), 2, kind == "other_silence")
        if not found["hidden"]:
            return found, {"other_false_alarms": not studies.quiet(found)}
        named, held = studies.named_first(found), studies.held(found)
        return found, {"other_named": named} | ({} if held is None else {"other_size_held": held})
    found = hidden_effects.case(kind, seed, hidden_effects.PAIR, False)
    if kind == "silence":
        return found, {"false_alarms": not studies.quiet(found)}
    if kind == "unknown":
        return found, {"unexplained": bool(found["unexplained"])}
    if hidden_effects.size(found) < studies.CLEAR:  # the record could not show it
        return found, {}
    held = studies.held(found)
    return found, {"named": hidden_effects.named_first(found)} | ({} if held is None else {"size_held": held})


def _identified(seed: int, posterior: bool) -> tuple[Row, dict[str, bool]]:
    """Errors of one fit's parameters go together, so one parameter, drawn at random, makes the trial."""
    import interval_coverage

    found = interval_coverage.case(seed, sample=posterior)
    names = found["names"]
    k = int(np.random.default_rng([seed, 98]).integers(len(names)))
    truth = interval_coverage.TRUTH[names[k]]
    keys = dict(zip(interval_coverage.IDENTIFIED, ("bound_held", "posterior_held"), strict=True))
    held = {keys[method]: bool(ends[k][0] <= truth <= ends[k][1]) for method, ends in found["ends"].items()}
    return found | {"parameter": names[k]}, held


def main() -> int:
    """Run, report, enter; the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, help=f"(default: as time allows, at most {FULL})")
    parser.add_argument("--minutes", type=float, help="after which no flight is begun (default: 10; none with --full)")
    parser.add_argument("--full", action="store_true", help=f"{FULL} rounds, with posteriors, for as long as it takes")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=HERE.parent / "out" / "verify")
    parser.add_argument("--ledger", type=Path, default=LEDGER)
    given = parser.parse_args()
    minutes = given.minutes or (float("inf") if given.full else 10.0)
    first = SEEDS[0] + secrets.randbelow(SEEDS[1] - SEEDS[0])
    run, folder = Run(commit_of(HERE), given.rounds or FULL, given.full, first), given.out / str(first)
    rows: list[Row] = []
    print(f"commit {run.commit}, seeds from {run.first}, flights in {folder}", flush=True)
    try:
        with ProcessPoolExecutor(given.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
            fly(run, folder, case, pool, given.workers, 60.0 * minutes, rows)
    finally:  # an interruption must not hide what was found
        line = line_of(run, rows)
        report(rows)
        enter(line, given.ledger)
    print(f"{line['verdict']}; entered in {given.ledger}")
    return int(line["verdict"] != "not refuted")


if __name__ == "__main__":
    sys.exit(main())
