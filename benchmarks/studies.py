"""What studies share: the command line, cases kept line by line, and what is kept of a diagnosis."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.record import FlightRecord
from bayes_aero.processes import full_of_programs, give_back_memory

Row = dict[str, Any]
Z95 = 1.959963984540054


def rows_of(path: Path) -> list[Row]:
    """Lines of a file; none where it is not there."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []


def resumed(
    path: Path,
    cases: Mapping[Hashable, Callable[[], Row]],
    key: Callable[[Row], Hashable] = lambda row: row["seed"],
    *,
    one_length: bool = False,
) -> list[Row]:
    """Rows of the file, and of the cases that it lacks, written one by one.

    Args:
        path: the file; its folder is made.
        cases: what gives the row of each key. A case that cannot be flown is named and left out.
        key: of a row.
        one_length: of all records, which one compilation serves.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = rows_of(path)
    done = {key(row) for row in rows}
    for name, case in cases.items():
        if name in done:
            continue
        try:
            rows.append(case())
        except InputError as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        if not one_length or full_of_programs():
            give_back_memory()  # every length of records has compiled programs of its own
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(rows[-1]) + "\n")
    return rows


def parser_of(
    doc: str | None, out: str = "", kinds: Sequence[str] = (), *, first: int | None = 0, count: int | None = None
) -> argparse.ArgumentParser:
    """A study's command line: which, how many seeds, from which, and the folder of its lines where it keeps any."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    if kinds:
        parser.add_argument("what", choices=kinds)
    parser.add_argument("count", type=int, default=count, nargs=None if count is None else "?")
    parser.add_argument("--first", type=int, default=first, help="first seed")
    if out:
        parser.add_argument("--out", type=Path, default=Path(out))
    return parser


def seeds_of(given: argparse.Namespace) -> range:
    """As the command line asks."""
    return range(given.first, given.first + given.count)


def run_seeds(
    given: argparse.Namespace, name: str, case: Callable[..., Row], *, one_length: bool = False, **settings: Any
) -> list[Row]:
    """Rows of all seeds asked for, and of those that OUT/`name` has already."""
    cases = {seed: partial(case, seed, **settings) for seed in seeds_of(given)}
    return resumed(given.out / name, cases, one_length=one_length)


def told(found: Diagnosis, began: float) -> Row:
    """What a diagnosis says, and the seconds since it `began`."""
    return {
        "verdict": found.verdict.value,
        "causes": {c.name: {p: [s.mean, s.sd] for p, s in c.parameters.items()} for c in found.causes},
        "ambiguous": {c.name: list(c.ambiguous_with) for c in found.causes},
        "together": [list(pair.effects) for pair in found.together],
        "absorbed": [sorted(one.members) for one in found.absorbed],
        "unexplained": [[u.coefficient, u.channel] for u in found.unknown],
        "seconds": time.perf_counter() - began,
    }


def alone(row: Row) -> bool:
    """Whether what is hidden is named, and nothing else named or unexplained."""
    return list(row["causes"]) == [row["hidden"]] and row["verdict"] == "explained"


def print_silent(rows: Sequence[Row]) -> None:
    """How many flights with nothing hidden get no finding."""
    print(f"nothing hidden: silent {sum(r['verdict'] == 'no_effect' for r in rows)} of {len(rows)}")


def print_sizes(sizes: Sequence[tuple[float, float, float]]) -> None:
    """Of how many (mean, deviation, truth) the interval holds the truth."""
    inside = sum(abs(mean - truth) < 1.96 * sd for mean, sd, truth in sizes)
    print(f"its 95 % interval holds the size {inside} of {len(sizes)}")


def standard_scores(found: Diagnosis, effects: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Each hidden effect's size over the standard error that its first screening gave it.

    The largest over its parameters, and over the stages in which it stood (flight path, coefficients); an effect that
    stood in neither has none.
    """
    scores: dict[str, float] = {}
    for name, values in effects.items():
        for stage in (found.sensors, found.aerodynamics):
            standing = stage.steps[0].screening.of(name) if stage is not None and stage.steps else None
            if standing is not None:
                owned = [p for p in CATALOGUE[name].parameters if p.name in values]
                sizes = [
                    abs(values[p.name] - p.neutral) / max(sd, 1e-300) for p, sd in zip(owned, standing.sd, strict=False)
                ]
                scores[name] = max(scores.get(name, 0.0), *sizes)
    return scores


def without_accelerometers(record: FlightRecord) -> FlightRecord:
    """The same flight as a recorder without accelerometers would have it."""
    kept = {name: x for name, x in record.channels.items() if name not in ("ax", "ay", "az")}
    return FlightRecord.from_arrays(record.name, record.time, kept)


def mean_and_error(each: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """Mean of independent cases with its standard error."""
    return float(np.mean(each)), float(np.std(each, ddof=1) / np.sqrt(len(each)))
