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

import time
from typing import Any

import numpy as np
from hidden_effects import candidates
from studies import parser_of, run_seeds, told

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
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


def case(seed: int) -> dict:
    """Draw, fly, diagnose; and once more with the test points, if there are any."""
    rng = np.random.default_rng([seed, 71])
    name = str(rng.choice(open_to_rivals()))
    effects, kinds = {name: draw_hidden(rng, name)}, FIRST[int(rng.integers(len(FIRST)))]
    row: dict[str, Any] = {"seed": seed, "hidden": effects, "first": list(kinds)}
    try:
        records = [flown(effects, 100 * seed + k, kind, manoeuvre=kind) for k, kind in enumerate(kinds)]
    except InputError as error:
        return row | {"refused": str(error)}
    began = time.perf_counter()
    found = diagnose(records, CARD, seed=seed, settings=DiagnosisSettings(gains=False, process_noise=False))
    row |= {"before": told(found, began), "points": proposed_points(found, CARD.envelope)}
    if row["points"].get("points"):
        for k, p in enumerate(row["points"]["points"]):
            asked = {key: p[key] for key in ("manoeuvre", "amplitude", "airspeed", "altitude")}
            try:
                records.append(flown(effects, 100 * seed + 50 + k, f"point {k + 1}", duration=p["seconds"], **asked))
            except InputError as error:
                row.setdefault("not_flown", []).append(str(error))
        row["after"] = told(
            diagnose(records, CARD, seed=seed, settings=DiagnosisSettings(gains=False, process_noise=False)), began
        )
    return row


def outcome(row: dict) -> str:
    """`decided`, `wrong`, `open` or `gone` after the test points."""
    (hidden,), after = row["hidden"], row["after"]
    if hidden in after["causes"]:
        rivals = after["ambiguous"][hidden] or any(hidden in pair for pair in after["together"])
        return "open" if rivals or any(hidden in one for one in after["absorbed"]) else "decided"
    if any(hidden in others for others in after["ambiguous"].values()):
        return "open"
    return "wrong" if after["causes"] else "gone"


def report(rows: list[dict]) -> None:
    """How many were open at first, and what became of them."""
    tried = [r for r in rows if "refused" not in r]
    asked = [r for r in tried if r["points"]]
    among = [r for r in asked if next(iter(r["hidden"])) in {e for q in r["points"]["questions"] for e in q["effects"]}]
    flown_again = [r for r in among if "after" in r]
    print(f"{len(tried)} flights; open {len(asked)}, the hidden effect among the rivals in {len(among)}")
    print(f"no test point decides more: {len(among) - len(flown_again)}")
    for decided in (True, False):
        own = [r for r in flown_again if _expected(r) == decided]
        counts = {what: sum(outcome(r) == what for r in own) for what in ("decided", "open", "wrong", "gone")}
        print("expected to be decided:" if decided else "expected to stay open:", len(own), counts)


def _expected(row: dict) -> bool:
    """Whether the question that has the hidden effect was expected to be decided."""
    (hidden,), last = row["hidden"], row["points"]["points"][-1]["standard_errors"]
    own = [k for k, q in enumerate(row["points"]["questions"]) if hidden in q["effects"]]
    return all(last[k] >= row["points"]["questions"][k]["enough"] for k in own)


def unlike(seed: int, silent: bool) -> dict:
    """Draw, fly and diagnose."""
    rng = np.random.default_rng([seed, 83])
    kinds = [str(k) for k in rng.choice(UNLIKE, int(rng.integers(2, 4)), replace=False)]
    name = str(rng.choice(open_to_rivals()))
    effects = {} if silent else {name: draw_hidden(rng, name)}
    row = {"seed": seed, "hidden": effects, "kinds": kinds}
    try:
        records = [flown(effects, 100 * seed + k, kind, manoeuvre=kind) for k, kind in enumerate(kinds)]
    except InputError as error:
        return row | {"refused": str(error)}
    began = time.perf_counter()
    return row | told(
        diagnose(records, CARD, seed=seed, settings=DiagnosisSettings(gains=False, process_noise=False)), began
    )


def report_unlike(rows: list[dict], silent: bool) -> None:
    """Counts."""
    tried = [r for r in rows if "refused" not in r]
    if silent:
        quiet = sum(not r["causes"] and not r["unexplained"] for r in tried)
        print(f"nothing hidden: no finding in {quiet} of {len(tried)}")
    else:
        first = [r for r in tried if next(iter(r["causes"]), None) in r["hidden"]]
        named = [r for r in tried if set(r["hidden"]) & set(r["causes"])]
        sets = [r for r in tried if any(set(r["hidden"]) & set(x) for x in r["ambiguous"].values())]
        false = [r for r in tried if r["causes"] and r not in named and r not in sets]
        print(f"{len(tried)} flights: named {len(named)}, first {len(first)}, among the rivals of a cause {len(sets)}")
        print(f"only another cause {len(false)}; unexplained {sum(bool(r['unexplained']) for r in tried)}")


if __name__ == "__main__":
    parser = parser_of(__doc__, "standard", ("points", "unlike"))
    parser.add_argument("--silent", action="store_true")
    given = parser.parse_args()
    if given.what == "points":
        report(run_seeds(given, "points.jsonl", case))
    else:
        name = "silent.jsonl" if given.silent else "hidden.jsonl"
        report_unlike(run_seeds(given, name, unlike, silent=given.silent), given.silent)
