"""Hide an effect in a few standard manoeuvres, which cannot always name it, and diagnose.

    python benchmarks/standard_manoeuvres.py points 60 [--first 0] [--out standard]
    python benchmarks/standard_manoeuvres.py unlike 60 [--first 0] [--silent] [--out standard]

Each flight draws an effect of the catalogue, its size, and the manoeuvres, simulated with coloured disturbances and
sensor noise. `points`: one or two manoeuvres. Where the diagnosis ends with an ambiguity, with effects that cancel or
with an effect that a control at rest may have taken up, the test points that it proposes are simulated, with the truth
and noise of their own, and diagnosed together with the first records. A flight counts as decided rightly if the hidden
effect is then named without a rival. `unlike`: two or three unlike manoeuvres, of which one does not predict another
(`--silent`: nothing hidden). One line of OUT/points.jsonl, hidden.jsonl or silent.jsonl each.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import studies
from hidden_effects import candidates
from studies import Row, hidden, share

from bayes_aero.effect import Kind, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.diagnose import proposed_points
from bayes_aero.simulate.demo import Request
from bayes_aero.simulate.injection import draw_hidden, synthetic

FIRST = (("slow_stall",), ("elevator_3211",), ("slow_stall", "elevator_3211"), ("thrust_steps",))
UNLIKE = ("slow_stall", "elevator_3211", "thrust_steps", "speed_change", "bank_to_bank", "elevator_doublet")
AT_REST = {"stabilizer", "flap", "spoiler", "dlc", "canard", "beta", "phi", "rudder", "aileron"}
CARD = read_card("attas")


def open_to_rivals() -> list[str]:
    """Effects that the first manoeuvres can show and the flight path does not decide: no error of a sensor or wind,
    and none of a control at rest."""
    known = [CATALOGUE[name] for name in candidates()]
    seen = [e for e in known if e.stage is not Stage.CHANNEL or e.kind is Kind.PROPULSION]
    return [e.name for e in seen if not AT_REST & {c.split("_")[0] for c in e.channels}]


def flown(effects: dict, seed: int, name: str, **asked: Any) -> FlightRecord:
    """One simulated manoeuvre with the hidden effects."""
    return synthetic(Request(effects, seed=seed, **asked), CARD, CATALOGUE, name=name).record


def all_flown(row: Row, kinds: list[str]) -> list[FlightRecord]:
    """The manoeuvres with what the row hides; none, and why in the row, where one cannot be flown."""
    try:
        return [flown(row["hidden"], 100 * row["seed"] + k, kind, manoeuvre=kind) for k, kind in enumerate(kinds)]
    except InputError as error:
        row["refused"] = str(error)
        return []


def case(seed: int) -> Row:
    """Draw, fly, diagnose; and once more with the test points, if there are any."""
    rng = np.random.default_rng([seed, 71])
    name = str(rng.choice(open_to_rivals()))
    effects, kinds = {name: draw_hidden(rng, name)}, FIRST[int(rng.integers(len(FIRST)))]
    row: Row = {"seed": seed, "hidden": effects, "first": list(kinds)}
    if not (records := all_flown(row, list(kinds))):
        return row
    found, before = studies.diagnosed(records, CARD, seed, process_noise=False)
    row |= {"before": before, "points": proposed_points(found, CARD.envelope)}
    if row["points"].get("points"):
        for k, p in enumerate(row["points"]["points"]):
            asked = {key: p[key] for key in ("manoeuvre", "amplitude", "airspeed", "altitude")}
            try:
                records.append(flown(effects, 100 * seed + 50 + k, f"point {k + 1}", duration=p["seconds"], **asked))
            except InputError as error:
                row.setdefault("not_flown", []).append(str(error))
        row["after"] = studies.diagnosed(records, CARD, seed, process_noise=False)[1]
    return row


def outcome(row: Row) -> str:
    """`decided`, `wrong`, `open` or `gone` after the test points."""
    name, after = hidden(row), row["after"]
    if name in after["causes"]:
        rivals = after["ambiguous"][name] or any(name in pair for pair in after["together"])
        return "open" if rivals or any(name in members for members in after["absorbed"]) else "decided"
    if studies.named(after, name):
        return "open"
    return "wrong" if after["causes"] else "gone"


def report(rows: list[Row]) -> None:
    """How many were open at first, and what became of them."""
    tried = [r for r in rows if "refused" not in r]
    asked = [r for r in tried if r["points"]]
    among = [r for r in asked if any(hidden(r) in q["effects"] for q in r["points"]["questions"])]
    flown_again = [r for r in among if "after" in r]
    print(f"{len(tried)} flights; open {len(asked)}, the hidden effect among the rivals in {len(among)}")
    print(f"no test point decides more: {len(among) - len(flown_again)}")
    for decided in (True, False):
        counts = Counter(outcome(r) for r in flown_again if _expected(r) == decided)
        print("expected to be decided:" if decided else "expected to stay open:", counts.total(), dict(counts))


def _expected(row: Row) -> bool:
    """Whether the question that has the hidden effect was expected to be decided."""
    last = row["points"]["points"][-1]["standard_errors"]
    questions = zip(row["points"]["questions"], last, strict=True)
    return all(error >= q["enough"] for q, error in questions if hidden(row) in q["effects"])


def unlike(seed: int, silent: bool) -> Row:
    """Draw, fly and diagnose."""
    rng = np.random.default_rng([seed, 83])
    kinds = [str(k) for k in rng.choice(UNLIKE, int(rng.integers(2, 4)), replace=False)]
    name = str(rng.choice(open_to_rivals()))
    row: Row = {"seed": seed, "hidden": {} if silent else {name: draw_hidden(rng, name)}, "kinds": kinds}
    records = all_flown(row, kinds)
    return row | (studies.diagnosed(records, CARD, seed, process_noise=False)[1] if records else {})


def report_unlike(rows: list[Row]) -> None:
    """Counts."""
    tried = [r for r in rows if "refused" not in r]
    studies.print_silent([r for r in tried if not r["hidden"]])
    some = [r for r in tried if r["hidden"]]
    among = [studies.named(r, hidden(r)) for r in some]
    false = share(r["causes"] and not right for r, right in zip(some, among, strict=True))
    print(f"one effect: named {share(hidden(r) in r['causes'] for r in some)}, first "
          f"{share(map(studies.named_first, some))}, named or a rival {share(among)}, "
          f"only another cause {false}, unexplained {share(r['unexplained'] for r in some)}")  # fmt: skip


if __name__ == "__main__":
    parser = studies.parser_of(__doc__, "standard", ("points", "unlike"))
    parser.add_argument("--silent", action="store_true")
    given = parser.parse_args()
    if given.what == "points":
        report(studies.run_seeds(given, "points.jsonl", case))
    else:
        name = "silent.jsonl" if given.silent else "hidden.jsonl"
        report_unlike(studies.run_seeds(given, name, unlike, silent=given.silent))
