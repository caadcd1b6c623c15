"""Hide effects in simulated flights, diagnose, and count: silence, naming, pairs, unknowns, power.

    python benchmarks/hidden_effects.py silence 200 --out study     # nothing hidden
    python benchmarks/hidden_effects.py one 200 --out study         # one effect, its table and confusion matrix
    python benchmarks/hidden_effects.py two 100 --out study         # two effects
    python benchmarks/hidden_effects.py unknown 60 --out study      # effects of no catalogue
    python benchmarks/hidden_effects.py report --out study          # tables of everything found so far
    python benchmarks/hidden_effects.py effects --out study         # power by effect
    python benchmarks/hidden_effects.py one 60 --single --out alone # on a single manoeuvre
    python benchmarks/hidden_effects.py one 30 --trajectories --out flown   # without accelerometers

Every flight's finding is one line of OUT/<kind>.jsonl; a study that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from studies import Row, parser_of, rows_of, run_seeds, standard_scores, without_accelerometers

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from out_of_catalogue import UNKNOWN
from out_of_catalogue import unknown as of_no_catalogue

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.injection import FLOWN_AXES, flyable, hidden_records

NOISES = ("white", "ar1", "ar1", "buffet", "outliers")
PAIR, SINGLE = {"seconds": 90.0}, {"seconds": 100.0, "manoeuvres": 1}  # one length: one compilation serves all
CLEAR = 6.0  # standard errors from which an effect must be named
EDGES = (0.0, 2.0, 4.0, 6.0, 9.0, 15.0, np.inf)  # standard errors of the first screening


def candidates() -> list[str]:
    """Effects that can be hidden: every one of the catalogue that is not a term of the base aircraft."""
    base = set(TRUTH) - {"tau1"}
    known = [e for e in CATALOGUE.values() if e.candidate and e.sizes and e.acts_on(FLOWN_AXES)]
    return [e.name for e in known if not {p.name for p in e.parameters} & base]


def case(kind: str, seed: int, length: dict, trajectories: bool) -> dict:
    """Draw, fly and diagnose one case."""
    rng = np.random.default_rng([seed, 99])
    noise, unknown, effects = str(rng.choice(NOISES)), None, {}
    if kind == "silence":
        records = hidden_records({}, seed=seed, noise=noise, **length)
    elif kind == "unknown":
        unknown = str(rng.choice(sorted(e.name for e in UNKNOWN)))
        records = hidden_records({}, seed=seed, noise=noise, beyond=of_no_catalogue(unknown), **length)
    else:
        names = [str(x) for x in rng.choice(candidates(), 1 if kind == "one" else 2, replace=False)]
        effects, flights = flyable(names, seed=seed, noise=noise, **length)
        records = [flight.record for flight in flights]
    began = time.perf_counter()
    if trajectories:
        found = diagnose([without_accelerometers(r) for r in records], read_card("attas"), seed=seed)
    else:
        found = diagnose(records, read_card("attas"), seed=seed, settings=DiagnosisSettings(gains=False))
    return {
        "seed": seed,
        "noise": noise,
        "unknown": unknown,
        "hidden": effects,
        "verdict": found.verdict.value,
        "causes": [
            {
                "name": c.name,
                "probability": c.probability,
                "ambiguous_with": c.ambiguous_with,
                "parameters": {k: [v.mean, v.sd] for k, v in c.parameters.items()},
            }
            for c in found.causes
        ],
        "minor": found.minor,
        "unexplained": [[u.coefficient, u.channel, u.share] for u in found.unknown],
        "changes": [[c.parameter, c.manoeuvre, c.at, *c.size] for c in found.changes],
        "scores": standard_scores(found, effects),
        "not_testable": sorted(found.not_testable),
        "seconds": time.perf_counter() - began,
    }


def case_or_refusal(kind: str, seed: int, length: dict, trajectories: bool) -> dict:
    """An aircraft that cannot be flown so is counted, not hidden."""
    try:
        return case(kind, seed, length, trajectories)
    except InputError as error:
        return {"seed": seed, "refused": str(error)}


def _share(hits: int, of: int) -> str:
    return f"{hits}/{of} = {hits / of:.1%}" if of else "0/0"


def alarmed(row: dict) -> bool:
    """Whether anything is named or left unexplained, even where the verdict does not rest on it."""
    return row["verdict"] != "no_effect" or bool(row["causes"])


def report(out: Path) -> None:
    """Print the tables."""
    rows = {kind: rows_of(out / f"{kind}.jsonl") for kind in ("silence", "one", "two", "unknown")}
    refused = {kind: sum("refused" in r for r in rs) for kind, rs in rows.items()}
    rows = {kind: [r for r in rs if "refused" not in r] for kind, rs in rows.items()}
    print("refused as unflyable:", refused)
    silence = rows["silence"]
    for noise in ("white", "ar1", "buffet", "outliers"):
        here = [r for r in silence if r["noise"] == noise]
        print(f"silence, {noise}: false alarms {_share(sum(alarmed(r) for r in here), len(here))}")
    print("silence, all: false alarms", _share(sum(alarmed(r) for r in silence), len(silence)))
    print("  named falsely:", Counter(c["name"] for r in silence for c in r["causes"]).most_common())
    if rows["one"]:
        _naming(rows["one"])
    two = [r for r in rows["two"] if len(r["scores"]) == 2 and min(r["scores"].values()) >= CLEAR]
    both = sum(all(named(r, name) for name in r["hidden"]) for r in two)
    print(f"two effects, both >= {CLEAR:g} standard errors: both named {_share(both, len(two))}")
    unknown = rows["unknown"]
    for stray in sorted({r["unknown"] for r in unknown}):
        here = [r for r in unknown if r["unknown"] == stray]
        print(
            f"unknown {stray}: unexplained {_share(sum(bool(r['unexplained']) for r in here), len(here))}, "
            f"misnamed {_share(sum(bool(r['causes']) for r in here), len(here))}, channels "
            f"{Counter(u[0] + ' ' + u[1].split(',')[0] for r in here for u in r['unexplained'][:1]).most_common(4)}"
        )
    every = [r["seconds"] for rs in rows.values() for r in rs]
    print(f"seconds a diagnosis: median {np.median(every):.1f}, 95 % below {np.quantile(every, 0.95):.1f}")


def named_first(row: dict) -> bool:
    """Whether the hidden effect is the first cause, or in its ambiguity set."""
    first = row["causes"][0] if row["causes"] else None
    return first is not None and (first["name"] == hidden(row) or hidden(row) in first["ambiguous_with"])


def inside(row: dict) -> bool | None:
    """Whether the 95 % intervals of the hidden effect hold its sizes; None where it is no cause."""
    name = hidden(row)
    for cause in row["causes"]:
        if cause["name"] == name:
            found = [(*cause["parameters"][p], value) for p, value in row["hidden"][name].items()]
            return all(abs(mean - value) <= 1.96 * sd for mean, sd, value in found)
    return None


def _naming(rows: list[dict]) -> None:
    clear = [r for r in rows if size(r) >= CLEAR]
    first = alone = 0
    missed: Counter[tuple[str, str]] = Counter()
    for r in clear:
        name, right = hidden(r), named_first(r)
        leader = r["causes"][0] if r["causes"] else None
        first += right
        alone += (
            leader is not None and leader["name"] == name and len(r["causes"]) == 1 and not leader["ambiguous_with"]
        )
        if not right:
            missed[(name, leader["name"] if leader else "nothing" + (" (minor)" if name in r["minor"] else ""))] += 1
    held = [x for x in map(inside, clear) if x is not None]
    print(f"one effect >= {CLEAR:g} standard errors: first or in the ambiguity set {_share(first, len(clear))}, "
          f"alone and first {_share(alone, len(clear))}, interval covers {_share(sum(held), len(held))}")  # fmt: skip
    print("  confused (true, named):", missed.most_common())
    for head, classes in zip(heads(), zip(*power(rows).values(), strict=True), strict=True):
        hits, of = (sum(counts) for counts in zip(*classes, strict=True))
        print(f"  power, {head} standard errors: named {_share(hits, of)}")


def named(row: Row, name: str) -> bool:
    """Whether an effect is a cause, or stands in one's ambiguity set."""
    return any(c["name"] == name or name in c["ambiguous_with"] for c in row["causes"])


def hidden(row: Row) -> str:
    """The one effect that a record hides."""
    (name,) = row["hidden"]
    return name


def size(row: Row) -> float:
    """Its size in standard errors."""
    return max(row["scores"].values(), default=0.0)


def power(rows: Sequence[Row]) -> dict[str, list[tuple[int, int]]]:
    """By effect: named and all in every class of size."""
    table = {}
    for name in sorted({hidden(r) for r in rows}):
        own = [r for r in rows if hidden(r) == name]
        classes = [[r for r in own if low <= size(r) < high] for low, high in pairwise(EDGES)]
        table[name] = [(sum(named(r, name) for r in here), len(here)) for here in classes]
    return table


def heads() -> list[str]:
    """The classes of size in words."""
    last = len(EDGES) - 2
    return [f"{a:g} to {b:g}" if k < last else f"from {a:g}" for k, (a, b) in enumerate(pairwise(EDGES))]


def print_power(rows: Sequence[Row]) -> None:
    """As a table for benchmarks/README.md."""
    print("| effect | " + " | ".join(heads()) + " |")
    print("|---|" + "---|" * len(heads()))
    for name, classes in power(rows).items():
        print(f"| `{name}` | " + " | ".join(f"{hits}/{of}" if of else "" for hits, of in classes) + " |")


def main() -> None:
    """Run a study, or report on what is there."""
    kinds = ("silence", "one", "two", "unknown", "report", "effects")
    parser = parser_of(__doc__, "study", kinds, first=1000, count=200)
    parser.add_argument("--single", action="store_true", help="one manoeuvre of 100 s instead of two of 90 s")
    parser.add_argument("--trajectories", action="store_true", help="without accelerometers, by simulated trajectories")
    given = parser.parse_args()
    if given.what == "report":
        report(given.out)
    elif given.what == "effects":
        print_power([r for r in rows_of(given.out / "one.jsonl") if "refused" not in r])
    else:
        length = SINGLE if given.single else PAIR
        one = partial(case_or_refusal, given.what, length=length, trajectories=given.trajectories)
        run_seeds(given, f"{given.what}.jsonl", one, one_length=True)


if __name__ == "__main__":
    main()
