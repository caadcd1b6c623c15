"""Hide a lateral effect in flights of another simulator in six degrees of freedom, and diagnose.

    python benchmarks/lateral_effects.py 120 [--first 0] [--silent] [--out lateral]

Aircraft are drawn at random and flown by `tests/stranger_six.py`, which shares no code with the package: elevator,
aileron and rudder, each twice, 25 Hz, white noise. The card has the true model but for one thing. Of four flights one
has nothing hidden, one something of `UNKNOWN`, which no effect of the catalogue makes, and two an effect of `HIDDEN`:
an aerodynamic one that is left off the card, or an error of the aircraft's constants or of a sensor. With `--silent`
those with nothing hidden are flown alone.
One line of OUT/lateral.jsonl each; goes on where it stopped.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float
from studies import alone, parser_of, print_silent, print_sizes, resumed, seeds_of, told

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from six_axes import ATTACHED, LATERAL, LONGITUDINAL, record
from stranger_six import Plane, drawn, fly
from wing_first import card_of

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.selection_state import DiagnosisSettings

FLOWN = ("elevator", "aileron", "rudder") * 2
AERODYNAMIC = {
    "rudder_roll": "Cldr", "aileron_yaw": "Cnda", "rudder_side_force": "CYdr", "roll_rate_yaw": "Cnp",
    "yaw_rate_roll": "Clr", "sideslip_cubed_yaw": "Cnbbb",
}  # fmt: skip
AIRCRAFT = {"lateral_cg_shift": ("aside", 0.1), "thrust_asymmetry": ("uneven", 0.1)}  # field of a `Plane`, size
SENSORS = {  # channel, size and kind of the error
    "sideslip_bias": ("beta", 0.01, "bias"),
    "sideslip_scale": ("beta", 0.05, "scale"),
    "roll_rate_scale": ("p", 0.05, "scale"),
    "yaw_rate_bias": ("r", 0.004, "bias"),
    "accel_y_bias": ("ay", 0.15, "bias"),
    "bank_angle_bias": ("phi", 0.02, "bias"),
    "aileron_delay": ("aileron", 0.08, "delay"),
    "rudder_delay": ("rudder", 0.08, "delay"),
}
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


def hidden(seed: int) -> str | None:
    """What this flight hides."""
    kind, turn = seed % 4, seed // 4
    return (None, UNKNOWN[turn % len(UNKNOWN)], HIDDEN[2 * turn % len(HIDDEN)], HIDDEN[(2 * turn + 1) % len(HIDDEN)])[
        kind
    ]


def case(seed: int) -> dict:
    """Draw, fly, record and diagnose."""
    rng, name = np.random.default_rng([seed, 21]), hidden(seed)
    plane = drawn(rng, **ATTACHED, Cnbbb=-1.5 * rng.uniform(0.7, 1.3) if name == "sideslip_cubed_yaw" else 0.0)
    size = getattr(plane, AERODYNAMIC[name]) if name in AERODYNAMIC else None
    if name in UNKNOWN:
        plane = _Odd(**{n: getattr(plane, n) for n in Plane.__dataclass_fields__}, odd=name)
    if name in AIRCRAFT:
        field, usual = AIRCRAFT[name]
        size = float(rng.choice([-1.0, 1.0]) * usual * rng.uniform(0.5, 1.5))
        plane = replace(plane, **{field: size})
    effects = tuple(e for e in (*LONGITUDINAL, *LATERAL) if e != name)
    flights = [fly(plane, kind, rng) for kind in FLOWN]
    if name in SENSORS:
        channel, usual, kind = SENSORS[name]
        size = usual * rng.uniform(0.8, 1.2)
        flights = [{**flight, channel: _wrong(flight[channel], kind, size, 0.04)} for flight in flights]
    records = [record(f"{FLOWN[i]}_{i}", flight, rng) for i, flight in enumerate(flights)]
    card = card_of(plane, effects)
    began = time.perf_counter()
    found = diagnose(records, card, seed=seed, settings=DiagnosisSettings(gains=False, process_noise=False))
    return {"seed": seed, "hidden": name, "size": size, **told(found, began)}


def report(rows: list[dict]) -> None:
    """Counts, what was taken for what, and a line for each that was not named alone."""
    print_silent([r for r in rows if r["hidden"] is None])
    unknown = [r for r in rows if r["hidden"] in UNKNOWN]
    unexplained, named = (sum(bool(r[what]) for r in unknown) for what in ("unexplained", "causes"))
    print(f"in no catalogue: unexplained {unexplained} of {len(unknown)}, a cause named {named}")
    some = [r for r in rows if r["hidden"] in HIDDEN]
    clear = list(filter(alone, some))
    print(f"one effect: named {sum(r['hidden'] in r['causes'] for r in some)} of {len(some)}, alone {len(clear)}")
    print_sizes([(*next(iter(r["causes"][r["hidden"]].values())), r["size"]) for r in clear])
    for (hidden, taken), count in sorted(Counter((r["hidden"], tuple(r["causes"])) for r in (*some, *unknown)).items()):
        print(f"  {hidden}: {', '.join(taken) or 'nothing'} ({count})")


if __name__ == "__main__":
    parser = parser_of(__doc__, "lateral")
    parser.add_argument("--silent", action="store_true")
    given = parser.parse_args()
    chosen = [seed for seed in seeds_of(given) if not (given.silent and hidden(seed))]
    report(resumed(given.out / "lateral.jsonl", {seed: partial(case, seed) for seed in chosen}))
