"""Hide a lateral effect, or a wing that stalls first, in flights in six degrees of freedom, and diagnose.

    python benchmarks/lateral_effects.py effects 120 [--first 0] [--silent] [--gusts 1] [--out lateral]
    python benchmarks/lateral_effects.py wing 18 [--first 0] [--silent] [--only stall] [--out lateral]

Aircraft are drawn at random and flown by `tests/stranger_six.py`, which shares no code with the package, at 25 Hz with
white noise. The card has the true model but for one thing. `--silent`: those with nothing hidden alone. `--gusts`:
their deviation along each body axis, m/s; the comparison is then that of the default.

`effects`: elevator, aileron and rudder, each twice. Of four flights one has nothing hidden, one something of `UNKNOWN`,
which no effect of the catalogue makes, and two an effect of `HIDDEN`: an aerodynamic one that is left off the card, or
an error of the aircraft's constants or of a sensor.

`wing`: elevator, aileron, rudder, a stall and two stalls in bank to and fro. Each half of the wing has a separation
point that lags. Hidden is a wing that stalls first, an offset of the recorded aileron (for which the catalogue has
`roll_offset`, the rolling moment that it makes), a centre of gravity aside, engines that deliver apart from what is
recorded, or an offset of the sideslip vane; every sixth flight is silent. `--only`: the records that are diagnosed.
One line of OUT/effects.jsonl or OUT/wing.jsonl each; goes on where it stopped.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import studies
from jaxtyping import Float
from six_axes import ATTACHED, LATERAL, LONGITUDINAL, STALL, card_in, record, recorded
from stranger_six import Plane, Strips, drawn, fly
from studies import Row, share

from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.jobs.diagnose import proposed_points

ONCE = ("elevator", "aileron", "rudder")
AERODYNAMIC = {
    "rudder_roll": "Cldr", "aileron_yaw": "Cnda", "rudder_side_force": "CYdr", "roll_rate_yaw": "Cnp",
    "yaw_rate_roll": "Clr", "sideslip_cubed_yaw": "Cnbbb",
}  # fmt: skip
AIRCRAFT = {"lateral_cg_shift": ("aside", 0.1), "thrust_asymmetry": ("uneven", 0.1)}  # field of a `Plane`, size
SENSORS = {  # channel, size and kind of the error
    "sideslip_bias": ("beta", 0.01, "bias"), "sideslip_scale": ("beta", 0.05, "scale"),
    "roll_rate_scale": ("p", 0.05, "scale"), "yaw_rate_bias": ("r", 0.004, "bias"),
    "accel_y_bias": ("ay", 0.15, "bias"), "bank_angle_bias": ("phi", 0.02, "bias"),
    "aileron_delay": ("aileron", 0.08, "delay"), "rudder_delay": ("rudder", 0.08, "delay"),
}  # fmt: skip
HIDDEN = (*AERODYNAMIC, *AIRCRAFT, *SENSORS)
UNKNOWN = ("altitude_roll", "aileron_sideslip_yaw", "aileron_play", "rudder_play")
PLAY = 0.01  # rad by which a surface stays behind either way


@dataclass(frozen=True)
class _Odd(Plane):
    """With something that no effect of the catalogue makes.

    A rolling moment that comes and goes with the altitude, a yawing moment of aileron times sideslip, or a surface that
    does not follow its recorded angle near neutral.
    """

    odd: str = ""

    def loads(self, x: np.ndarray, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the flight without it, and what it adds."""
        if self.odd.endswith("_play"):
            i = 1 if self.odd == "aileron_play" else 2
            moved = np.sign(controls[i]) * max(0.0, abs(controls[i]) - PLAY)
            return super().loads(x, np.concatenate([controls[:i], [moved], controls[i + 1 :]]))
        force, moment = super().loads(x, controls)
        scale = 0.5 * self.density(x[9]) * float(x[:3] @ x[:3]) * self.S * self.b
        if self.odd == "altitude_roll":
            return force, moment + np.array([0.002 * scale * np.sin(x[9] / 3.0), 0.0, 0.0])
        return force, moment + np.array([0.0, 0.0, scale * controls[1] * self.air_data(x)[2]])


def _wrong(x: Float[np.ndarray, " n"], kind: str, size: float, dt: float) -> Float[np.ndarray, " n"]:
    """What the recorder shows of a channel with this error."""
    if kind == "delay":
        index = np.arange(len(x))
        return np.interp(index - size / dt, index, x)
    return (1.0 + size) * x if kind == "scale" else x + size


def hides(what: str, seed: int) -> str | None:
    """What this flight hides."""
    if what == "wing":
        return None if seed % 6 == 5 else CAUSES[seed % 6]
    kind, turn = seed % 4, seed // 4
    unknown, first, second = UNKNOWN[turn % len(UNKNOWN)], HIDDEN[2 * turn % len(HIDDEN)], (2 * turn + 1) % len(HIDDEN)
    return (None, unknown, first, HIDDEN[second])[kind]


def card_of(plane: Plane, effects: Sequence[str]) -> Card:
    """A model of these effects; no constants of the aircraft but mass and geometry."""
    with tempfile.TemporaryDirectory() as folder:
        return card_in(Path(folder), plane, effects)


def made(cls: type, plane: Plane, **more: Any) -> Any:
    """The same aircraft of another class."""
    return cls(**{name: getattr(plane, name) for name in Plane.__dataclass_fields__}, **more)


def effects(seed: int, gusts: float = 0.0) -> Row:
    """Draw, fly, record and diagnose."""
    rng, name = np.random.default_rng([seed, 21]), hides("effects", seed)
    plane = drawn(rng, **ATTACHED, Cnbbb=-1.5 * rng.uniform(0.7, 1.3) if name == "sideslip_cubed_yaw" else 0.0)
    size = getattr(plane, AERODYNAMIC[name]) if name in AERODYNAMIC else None
    if name in UNKNOWN:
        plane = made(_Odd, plane, odd=name)
    if name in AIRCRAFT:
        field, usual = AIRCRAFT[name]
        size = float(rng.choice([-1.0, 1.0]) * usual * rng.uniform(0.5, 1.5))
        plane = replace(plane, **{field: size})
    flights = [fly(plane, kind, rng, gust=gusts) for kind in 2 * ONCE]
    if name in SENSORS:
        channel, usual, kind = SENSORS[name]
        size = usual * rng.uniform(0.8, 1.2)
        flights = [{**flight, channel: _wrong(flight[channel], kind, size, 0.04)} for flight in flights]
    records = [record(f"{ONCE[i % 3]}_{i}", flight, rng) for i, flight in enumerate(flights)]
    card = card_of(plane, tuple(e for e in (*LONGITUDINAL, *LATERAL) if e != name))
    found, row = studies.diagnosed(records, card, seed, process_noise=None if gusts else False)
    hidden = {name: {CATALOGUE[name].parameters[0].name: size}} if name in HIDDEN else {}
    scores = studies.standard_scores(found, hidden)
    return {"seed": seed, "hidden": hidden, "unknown": name if name in UNKNOWN else None, "scores": scores, **row}


def report_effects(rows: list[Row]) -> None:
    """Counts, what was taken for what, and a line for each that was not named alone."""
    unknown, some = [r for r in rows if r["unknown"]], [r for r in rows if r["hidden"]]
    studies.print_silent([r for r in rows if not r["unknown"] and not r["hidden"]])
    print(f"in no catalogue: unexplained {share(r['unexplained'] for r in unknown)}, "
          f"a cause named {share(r['causes'] for r in unknown)}")  # fmt: skip
    clear = list(filter(studies.alone, some))
    print(f"one effect: named {share(studies.hidden(r) in r['causes'] for r in some)}, alone {len(clear)}")
    studies.print_sizes(clear)
    taken = Counter((r["unknown"] or studies.hidden(r), tuple(r["causes"])) for r in (*some, *unknown))
    for (name, causes), count in sorted(taken.items()):
        print(f"  {name}: {', '.join(causes) or 'nothing'} ({count})")


# --- A wing that stalls first, and its rivals.

FLOWN = dict.fromkeys(ONCE, 120.0) | {"stall": 95.0, "stall_in_bank": 95.0, "again": 97.0}  # m/s
WINGS = ("roll_rate_incidence", "sideslip_incidence", "wing_lift_difference", "wing_drag_difference")
MODEL = (*LONGITUDINAL, *LATERAL, *STALL, *WINGS)
CAUSES = ("wing_asymmetry", "aileron_offset", "lateral_cg_shift", "thrust_asymmetry", "sideslip_bias")
NAMED = {"aileron_offset": "roll_offset"}  # under which name the catalogue has it
SIZES = {  # least and largest, of either sign; rad, m, share
    "wing_asymmetry": (0.01, 0.02), "aileron_offset": (0.008, 0.016), "lateral_cg_shift": (0.05, 0.15),
    "thrust_asymmetry": (0.05, 0.15), "sideslip_bias": (0.008, 0.02),
}  # fmt: skip


def flown(seed: int) -> tuple[Plane, list[FlightRecord], float]:
    """The aircraft, its records and the size of what is hidden, as the catalogue counts it."""
    rng, name = np.random.default_rng([seed, 33]), hides("wing", seed)
    plane = drawn(rng, alpha_star=rng.uniform(0.2, 0.22), tau1=rng.uniform(8.0, 16.0), Clp=-0.45, Clbe=-0.11)
    plane = made(Strips, plane)
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


def wing(seed: int, only: tuple[str, ...] = tuple(FLOWN)) -> Row:
    """Draw, fly, record and diagnose; `only` these records."""
    plane, records, size = flown(seed)
    records = [record for record in records if record.name in only]
    found, row = studies.diagnosed(records, card_of(plane, MODEL), seed, process_noise=False)
    points = [p["manoeuvre"] for p in proposed_points(found).get("points", ())]
    name = NAMED.get(str(hides("wing", seed)), hides("wing", seed))
    hidden = {} if name is None else {name: {CATALOGUE[name].parameters[0].name: size}}
    return {"seed": seed, "hidden": hidden, **row, "manoeuvres": points}


def report_wing(rows: list[Row]) -> None:
    """A line for each cause and one for the silent flights."""
    for cause in CAUSES:
        name = NAMED.get(cause, cause)
        own = [r for r in rows if studies.hidden(r) == name]
        alone = share(studies.alone(r) and not r["ambiguous"][name] for r in own)
        sets = sum(studies.named(r, name) and any(r["ambiguous"].values()) for r in own)
        print(f"{cause}: first {share(map(studies.named_first, own))}, alone {alone}, in a set {sets}; ", end="")
        studies.print_sizes(own)
    studies.print_silent([r for r in rows if not r["hidden"]])


if __name__ == "__main__":
    parser = studies.parser_of(__doc__, "lateral", ("effects", "wing"))
    parser.add_argument("--silent", action="store_true")
    parser.add_argument("--gusts", type=float, default=0.0, help="their deviation, m/s; of `effects`")
    parser.add_argument("--only", nargs="+", choices=tuple(FLOWN), default=tuple(FLOWN))
    given = parser.parse_args()
    chosen = [seed for seed in studies.seeds_of(given) if not (given.silent and hides(given.what, seed))]
    of_effects = partial(effects, gusts=given.gusts), report_effects
    case, report = of_effects if given.what == "effects" else (partial(wing, only=given.only), report_wing)
    report(studies.resumed(given.out / f"{given.what}.jsonl", {seed: partial(case, seed) for seed in chosen}))
