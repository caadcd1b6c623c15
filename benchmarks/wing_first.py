"""Hide a wing that stalls first, or one of four rivals, in stalls in bank of another simulator, and diagnose.

    python benchmarks/wing_first.py 18 [--first 0] [--out wing_first] [--only stall]

Aircraft are drawn at random and flown by `tests/stranger_six.py`, which shares no code with the package: elevator,
aileron, rudder, a stall and two stalls in bank to and fro, 25 Hz, white noise. Each half of the wing has a separation
point that lags. The card has the true model but for what is hidden: a wing that stalls first, an offset of the
recorded aileron (for which the catalogue has `roll_offset`, the rolling moment that it makes), a centre of gravity
aside, engines that deliver apart from what is recorded, or an offset of the sideslip vane. Every sixth flight is
silent. `--only`: the records that are diagnosed. One line of OUT/wing_first.jsonl each; goes on where it stopped.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from studies import parser_of, run_seeds, told

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from six_axes import LATERAL, LONGITUDINAL, STALL, card_text, recorded
from stranger_six import Plane, Strips, drawn, fly

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.selection_state import DiagnosisSettings
from bayes_aero.flight.card import Card, read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.diagnose import proposed_points

FLOWN = {"elevator": 120.0, "aileron": 120.0, "rudder": 120.0, "stall": 95.0, "stall_in_bank": 95.0, "again": 97.0}
WINGS = ("roll_rate_incidence", "sideslip_incidence", "wing_lift_difference", "wing_drag_difference")
EFFECTS = (*LONGITUDINAL, *LATERAL, *STALL, *WINGS)
CAUSES = ("wing_asymmetry", "aileron_offset", "lateral_cg_shift", "thrust_asymmetry", "sideslip_bias")
NAMED = {"aileron_offset": "roll_offset"}  # under which name the catalogue has it
SIZES = {  # least and largest, of either sign
    "wing_asymmetry": (0.01, 0.02),
    "aileron_offset": (0.008, 0.016),
    "lateral_cg_shift": (0.05, 0.15),
    "thrust_asymmetry": (0.05, 0.15),
    "sideslip_bias": (0.008, 0.02),
}  # rad, m, share


def hidden(seed: int) -> str | None:
    """What this flight hides."""
    return None if seed % 6 == 5 else CAUSES[seed % 6]


def flown(seed: int) -> tuple[Plane, list[FlightRecord], float]:
    """The aircraft, its records and the size of what is hidden, as the catalogue counts it."""
    rng, name = np.random.default_rng([seed, 33]), hidden(seed)
    plane = drawn(rng, alpha_star=rng.uniform(0.2, 0.22), tau1=rng.uniform(8.0, 16.0), Clp=-0.45, Clbe=-0.11)
    plane = Strips(**{n: getattr(plane, n) for n in Plane.__dataclass_fields__})
    size = 0.0 if name is None else float(rng.choice([-1.0, 1.0]) * rng.uniform(*SIZES[name]))
    fields = {"wing_asymmetry": "first", "lateral_cg_shift": "aside", "thrust_asymmetry": "uneven"}
    if name in fields:
        plane = replace(plane, **{fields[name]: -size if name == "wing_asymmetry" else size})
    records = []
    for kind, V in FLOWN.items():
        shown = recorded(fly(plane, "stall_in_bank" if kind == "again" else kind, rng, V=V), rng)
        shown["aileron"] += size * (name == "aileron_offset")
        shown["beta"] += size * (name == "sideslip_bias")
        channels = {n: x for n, x in shown.items() if n != "time"}
        channels["thrust"] = shown["thrust_left"] + shown["thrust_right"]
        records.append(FlightRecord.from_arrays(kind, shown["time"], channels, "simulated"))
    return plane, records, -plane.Clda * size if name == "aileron_offset" else size


def card_of(plane: Plane, effects: Sequence[str] = EFFECTS) -> Card:
    """A model of these effects; no constants of the aircraft but mass and geometry."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "another.toml"
        path.write_text(card_text(plane, effects), encoding="utf-8")
        return read_card(str(path))


def case(seed: int, only: tuple[str, ...] = tuple(FLOWN)) -> dict:
    """Draw, fly, record and diagnose; `only` these records."""
    plane, records, size = flown(seed)
    records = [record for record in records if record.name in only]
    began = time.perf_counter()
    found = diagnose(records, card_of(plane), seed=seed, settings=DiagnosisSettings(gains=False, process_noise=False))
    points = [p["manoeuvre"] for p in proposed_points(found).get("points", ())]
    return {"seed": seed, "hidden": hidden(seed), "size": size, **told(found, began), "manoeuvres": points}


def report(rows: list[dict]) -> None:
    """A line for each cause and one for the silent flights."""
    print(f"{'hidden':18} flights  named first  alone  in a set  size in 95 %")
    for cause in CAUSES:
        own, name = [r for r in rows if r["hidden"] == cause], NAMED.get(cause, cause)
        named = [r for r in own if name in r["causes"]]
        first = [r for r in named if next(iter(r["causes"])) == name]
        alone = [r for r in named if len(r["causes"]) == 1 and not r["ambiguous"][name] and not r["unexplained"]]
        among = [r for r in own if any(name in (c, *others) and others for c, others in r["ambiguous"].items())]
        sizes = [(r["size"], *next(iter(r["causes"][name].values()))) for r in named]
        inside = sum(abs(mean - size) < 1.96 * sd for size, mean, sd in sizes)
        print(f"{cause:18} {len(own):7} {len(first):12} {len(alone):6} {len(among):9} {inside:7} of {len(sizes)}")
    silent = [r for r in rows if r["hidden"] is None]
    quiet = sum(not r["causes"] and not r["unexplained"] for r in silent)
    print(f"nothing hidden: silent {quiet} of {len(silent)}")


if __name__ == "__main__":
    parser = parser_of(__doc__, "wing_first")
    parser.add_argument("--only", nargs="+", choices=tuple(FLOWN), default=tuple(FLOWN))
    given = parser.parse_args()
    report(run_seeds(given, "wing_first.jsonl", case, only=tuple(given.only)))
