"""Hide effects in simulated flights, diagnose, and count: silence, naming, pairs, unknowns, changes, power.

    python benchmarks/hidden_effects.py silence 200 --out study     # nothing hidden
    python benchmarks/hidden_effects.py one 200 --out study         # one effect, its table and confusion matrix
    python benchmarks/hidden_effects.py two 100 --out study         # two effects
    python benchmarks/hidden_effects.py unknown 60 --out study      # effects of no catalogue
    python benchmarks/hidden_effects.py change 20 --out study       # Cm0 or CLaM changes in the second manoeuvre
    python benchmarks/hidden_effects.py report --out study          # tables of everything found so far
    python benchmarks/hidden_effects.py effects --out study         # power by effect
    python benchmarks/hidden_effects.py one 60 --single --out alone # on a single manoeuvre
    python benchmarks/hidden_effects.py one 30 --trajectories --out flown   # without accelerometers

Every flight's finding is one line of OUT/<kind>.jsonl; a study that was interrupted goes on where it stopped.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import studies
from out_of_catalogue import AT, UNKNOWN, changed
from out_of_catalogue import unknown as of_no_catalogue
from studies import CLEAR, Row, hidden, named, rows_of, share

from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.injection import FLOWN_AXES, flyable, hidden_records

NOISES = ("white", "ar1", "ar1", "buffet", "outliers")
PAIR, SINGLE = {"seconds": 90.0}, {"seconds": 100.0, "manoeuvres": 1}  # one length: one compilation serves all
CHANGES = {"Cm0": (0.003, 0.012), "CLaM": (0.6, 2.0)}  # sizes, uniform in their logarithm, of either sign
EDGES = (0.0, 2.0, 4.0, 6.0, 9.0, 15.0, np.inf)  # standard errors of the first screening
KINDS = ("silence", "one", "two", "unknown", "change")


def candidates() -> list[str]:
    """Effects that can be hidden: every one of the catalogue that is not a term of the base aircraft."""
    base = set(TRUTH) - {"tau1"}
    known = [e for e in CATALOGUE.values() if e.candidate and e.sizes and e.acts_on(FLOWN_AXES)]
    return [e.name for e in known if not {p.name for p in e.parameters} & base]


def case(kind: str, seed: int, length: dict, trajectories: bool) -> Row:
    """Draw, fly and diagnose one case."""
    rng = np.random.default_rng([seed, 99])
    noise, stray, effects = str(rng.choice(NOISES)), None, {}
    flown = {"seed": seed, "noise": noise, **length}
    if kind == "silence":
        records = hidden_records({}, **flown)
    elif kind == "unknown":
        stray = str(rng.choice(sorted(e.name for e in UNKNOWN)))
        records = hidden_records({}, beyond=of_no_catalogue(stray), **flown)
    elif kind == "change":
        stray = str(rng.choice(sorted(CHANGES)))
        size = float(np.exp(rng.uniform(*np.log(CHANGES[stray]))) * rng.choice([-1.0, 1.0]))
        records, effects = changed(stray, size, **flown), {"change": {stray: size}}
    else:
        names = [str(x) for x in rng.choice(candidates(), 1 if kind == "one" else 2, replace=False)]
        effects, flights = flyable(names, **flown)
        records = [flight.record for flight in flights]
    records = [studies.without_accelerometers(r) for r in records] if trajectories else records
    found, row = studies.diagnosed(records, read_card("attas"), seed, gains=trajectories)
    return {
        **{"seed": seed, "noise": noise, "unknown": stray, "hidden": effects, **row},
        "changes": [[c.parameter, list(c.ambiguous_with), c.interval, c.size] for c in found.changes],
        "scores": studies.standard_scores(found, {} if kind == "change" else effects),
        "not_testable": sorted(found.not_testable),
    }


def case_or_refusal(kind: str, seed: int, length: dict, trajectories: bool) -> Row:
    """An aircraft that cannot be flown so is counted, not hidden."""
    try:
        return case(kind, seed, length, trajectories)
    except InputError as error:
        return {"seed": seed, "refused": str(error)}


def report(out: Path) -> None:
    """Print the tables."""
    rows = {kind: rows_of(out / f"{kind}.jsonl") for kind in KINDS}
    print("refused as unflyable:", {kind: sum("refused" in r for r in rs) for kind, rs in rows.items()})
    rows = {kind: [r for r in rs if "refused" not in r] for kind, rs in rows.items()}
    silence = rows["silence"]
    for noise in dict.fromkeys(NOISES):
        here = [r for r in silence if r["noise"] == noise]
        print(f"silence, {noise}: false alarms {share(not studies.quiet(r) for r in here)}")
    print(f"silence, all: false alarms {share(not studies.quiet(r) for r in silence)}, "
          f"a change claimed {share(r['changes'] for r in silence)}")  # fmt: skip
    print("  named falsely:", Counter(name for r in silence for name in r["causes"]).most_common())
    if rows["one"]:
        _naming(rows["one"])
    two = [r for r in rows["two"] if len(r["scores"]) == 2 and min(r["scores"].values()) >= CLEAR]
    both = share(all(named(r, name) for name in r["hidden"]) for r in two)
    print(f"two effects, both >= {CLEAR:g} standard errors: both named {both}")
    for stray in sorted({r["unknown"] for r in rows["unknown"]}):
        here = [r for r in rows["unknown"] if r["unknown"] == stray]
        channels = Counter(u[0] + " " + u[1].split(",")[0] for r in here for u in r["unexplained"][:1])
        print(f"unknown {stray}: unexplained {share(r['unexplained'] for r in here)}, "
              f"misnamed {share(r['causes'] for r in here)}, channels {channels.most_common(4)}")  # fmt: skip
    _changes(rows["change"])
    every = [r["seconds"] for rs in rows.values() for r in rs]
    print(f"seconds a diagnosis: median {np.median(every):.1f}, 95 % below {np.quantile(every, 0.95):.1f}")


def named_first(row: Row) -> bool:
    """Whether the hidden effect is the first cause, or in its ambiguity set."""
    first = next(iter(row["causes"]), None)
    return first is not None and hidden(row) in (first, *row["ambiguous"][first])


def _naming(rows: list[Row]) -> None:
    clear = [r for r in rows if size(r) >= CLEAR]
    first = share(map(named_first, clear))
    alone = share(list(r["causes"]) == [hidden(r)] and not r["ambiguous"][hidden(r)] for r in clear)
    print(f"one effect >= {CLEAR:g} standard errors: first or in the ambiguity set {first}, alone and first {alone}")
    studies.print_sizes(clear)
    missed = Counter(
        (name, next(iter(r["causes"]), "nothing" + (" (minor)" if name in r["minor"] else "")))
        for r, name in ((r, hidden(r)) for r in clear)
        if not named_first(r)
    )
    print("  confused (true, named):", missed.most_common())
    for head, classes in zip(heads(), zip(*power(rows).values(), strict=True), strict=True):
        hits, of = (sum(counts) for counts in zip(*classes, strict=True))
        print(f"  power, {head} standard errors: named {hits} of {of}")


def _changes(rows: list[Row]) -> None:
    """Whether the parameter that changed is the first change found, or one of its rivals; its time and its size."""
    first = [(r["changes"][0], *r["hidden"]["change"].items()) for r in rows if r["changes"]]
    exact = [(interval, found, size) for (name, _, interval, found), (true, size) in first if name == true]
    among = sum(true in (name, *rivals) for (name, rivals, *_), (true, _) in first)
    print(f"a change: claimed {len(first)} of {len(rows)}, first or a rival of the first {among}, "
          f"first {len(exact)}: time held {share(low <= AT <= high for (low, high), *_ in exact)}, "
          f"size {share(abs(mean - size) < 1.96 * sd for _, (mean, sd), size in exact)}")  # fmt: skip


def size(row: Row) -> float:
    """Of the hidden effect, in standard errors of the first screening; 0 where it stood in none."""
    return row["scores"].get(hidden(row), 0.0)


def power(rows: Sequence[Row]) -> dict[str, list[tuple[int, int]]]:
    """By effect: named and all in every class of size."""
    table = {}
    for name in sorted({str(hidden(r)) for r in rows}):
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
    parser = studies.parser_of(__doc__, "study", (*KINDS, "report", "effects"), first=1000, count=200)
    parser.add_argument("--single", action="store_true", help="one manoeuvre of 100 s instead of two of 90 s")
    parser.add_argument("--trajectories", action="store_true", help="without accelerometers, by simulated trajectories")
    given = parser.parse_args()
    if given.what == "effects":
        print_power([r for r in rows_of(given.out / "one.jsonl") if "refused" not in r])
        return
    if given.what in KINDS:
        length = SINGLE if given.single else PAIR
        one = partial(case_or_refusal, given.what, length=length, trajectories=given.trajectories)
        studies.run_seeds(given, f"{given.what}.jsonl", one, one_length=True)
    report(given.out)


if __name__ == "__main__":
    main()
