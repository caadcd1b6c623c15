"""What studies share: the command line, cases kept line by line, and what is kept of a diagnosis."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # simulators that share no code with the package

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import Diagnosis
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.reading import read_records
from bayes_aero.flight.record import FlightRecord
from bayes_aero.processes import full_of_programs, give_back_memory

Row = dict[str, Any]
Size = tuple[float, float, float]  # mean, deviation, truth
Z95 = 1.959963984540054
CLEAR = 6.0  # standard errors of the first screening from which an effect must be named


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


def records_of(parser: argparse.ArgumentParser) -> tuple[argparse.Namespace, Card, list[FlightRecord]]:
    """The command line of a study of records, their card, and the records."""
    parser.add_argument("records", nargs="+", type=Path)
    parser.add_argument("--model", default="attas", help="card of the records")
    given = parser.parse_args()
    card = read_card(given.model)
    return given, card, read_records(given.records, card.channels)


def parser_of(
    doc: str | None, out: str = "", kinds: Sequence[str] = (), *, first: int | None = 0, count: int | None = None
) -> argparse.ArgumentParser:
    """A study's command line: which, how many seeds, from which, and the folder of its lines where it keeps any."""
    parser = plain_parser(doc)
    if kinds:
        parser.add_argument("what", choices=kinds)
    parser.add_argument("count", type=int, default=count, nargs=None if count is None else "?")
    parser.add_argument("--first", type=int, default=first, help="first seed")
    if out:
        parser.add_argument("--out", type=Path, default=Path(out))
    return parser


def plain_parser(doc: str | None) -> argparse.ArgumentParser:
    """A command line that is explained as a module's docstring is written."""
    return argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


def seeds_of(given: argparse.Namespace) -> range:
    """As the command line asks."""
    return range(given.first, given.first + given.count)


def run_seeds(
    given: argparse.Namespace, name: str, case: Callable[..., Row], *, one_length: bool = False, **settings: Any
) -> list[Row]:
    """Rows of all seeds asked for, and of those that OUT/`name` has already."""
    cases = {seed: partial(case, seed, **settings) for seed in seeds_of(given)}
    return resumed(given.out / name, cases, one_length=one_length)


def diagnosed(records: Sequence[FlightRecord], card: Card, seed: int = 0, **settings: Any) -> tuple[Diagnosis, Row]:
    """A diagnosis without hold-out gains unless `settings` say otherwise, and what is kept of it, with its seconds."""
    began = time.perf_counter()
    found = diagnose(records, card, seed=seed, settings=DiagnosisSettings(**{"gains": False} | settings))
    return found, {
        "verdict": found.verdict.value,
        "causes": {c.name: {p: [s.mean, s.sd] for p, s in c.parameters.items()} for c in found.causes},
        "ambiguous": {c.name: list(c.ambiguous_with) for c in found.causes},
        "likely": [c.name for c in found.causes if c.likely],
        "minor": found.minor,
        "together": [list(pair.effects) for pair in found.together],
        "absorbed": [sorted(one.members) for one in found.absorbed],
        "unexplained": [[u.coefficient, u.channel, u.share, list(u.rivals)] for u in found.unknown],
        "seconds": time.perf_counter() - began,
    }


def hidden(row: Row) -> str | None:
    """The effect that a record hides, of `row["hidden"]`: true values of parameters by effect."""
    return next(iter(row["hidden"]), None)


def named(row: Row, name: str | None) -> bool:
    """Whether an effect is a cause, or stands in one's ambiguity set."""
    return any(name in (cause, *rivals) for cause, rivals in row["ambiguous"].items())


def named_first(row: Row) -> bool:
    """Whether what is hidden is the first cause."""
    return next(iter(row["causes"]), None) == hidden(row) is not None


def alone(row: Row) -> bool:
    """Whether what is hidden is named, and nothing else named or unexplained."""
    return list(row["causes"]) == [hidden(row)] and row["verdict"] == "explained"


def sizes(row: Row) -> list[Size]:
    """Of the hidden effect's parameters; none where it is no cause."""
    name = hidden(row)
    found = row["causes"].get(name, {})
    return [(*found[p], x) for p, x in row["hidden"][name].items()] if found else []


def held(row: Row) -> bool | None:
    """Whether the 95 % intervals of the hidden effect hold its sizes; None where it is no cause."""
    found = sizes(row)
    return all(abs(mean - truth) < Z95 * sd for mean, sd, truth in found) if found else None


def quiet(row: Row) -> bool:
    """Whether nothing is named, even where the verdict does not rest on it, and nothing unexplained."""
    return row["verdict"] == "no_effect" and not row["causes"]


def print_silent(rows: Sequence[Row]) -> None:
    """How many flights with nothing hidden get no finding."""
    print(f"nothing hidden: silent {share(map(quiet, rows))}")


def print_sizes(rows: Sequence[Row]) -> None:
    """How often the intervals of the hidden effect hold its sizes, where it is a cause."""
    print(f"its 95 % interval holds the size {share(x for x in map(held, rows) if x is not None)}")


def share(hits: Iterable[bool]) -> str:
    """How many of them are true."""
    each = list(hits)
    return f"{sum(map(bool, each))} of {len(each)}"


def standard_scores(found: Diagnosis, effects: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Each hidden effect's size over the standard error that its first screening gave it: the largest over its
    parameters and over the stages in which it stood (flight path, coefficients); without either it has none."""
    scores: dict[str, float] = {}
    for name, values in effects.items():
        for stage in (found.sensors, found.aerodynamics):
            score = stage.steps[0].screening.of(name) if stage is not None and stage.steps else None
            if score is not None:
                owned = [p for p in CATALOGUE[name].parameters if p.name in values]
                off = [
                    abs(values[p.name] - p.neutral) / max(sd, 1e-300) for p, sd in zip(owned, score.sd, strict=False)
                ]
                scores[name] = max(scores.get(name, 0.0), *off)
    return scores


def without_accelerometers(record: FlightRecord) -> FlightRecord:
    """The same flight as a recorder without accelerometers would have it."""
    kept = {name: x for name, x in record.channels.items() if name not in ("ax", "ay", "az")}
    return FlightRecord.from_arrays(record.name, record.time, kept)


def mean_and_error(each: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """Mean of independent cases with its standard error."""
    return float(np.mean(each)), float(np.std(each, ddof=1) / np.sqrt(len(each)))


def print_inside(names: Sequence[str], inside: np.ndarray) -> None:
    """Share of the truths that intervals hold, `inside` (cases, names): of all with its error, and of each."""
    print("  inside 95 %: {:.3f} +- {:.3f}".format(*mean_and_error(inside.mean(axis=1))))
    print("  " + ", ".join(f"{name} {x:.2f}" for name, x in zip(names, inside.mean(axis=0), strict=True)))
