"""Hide a lateral effect in flights of another simulator in six degrees of freedom, and diagnose.

    python benchmarks/lateral_effects.py 30 [--first 0] [--out lateral]

Aircraft are drawn at random and flown by `tests/stranger_six.py`, which shares no code with the package: elevator,
aileron and rudder, each twice, 25 Hz, white noise. The card has the true model but for one effect of `HIDDEN`: an
aerodynamic one that is left off the card, an error of a sensor, or `unknown`, a rolling moment that no effect of the
catalogue makes. Every fourth has nothing hidden. One line of OUT/lateral.jsonl each; goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from six_axes import ATTACHED, LATERAL, LONGITUDINAL, card_text, record
from stranger_six import Plane, drawn, fly

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.flight.card.card import read_card
from bayes_aero.inference.compiled_programs import give_back_memory

FLOWN = ("elevator", "aileron", "rudder") * 2
AERODYNAMIC = {
    "rudder_roll": "Cldr", "aileron_yaw": "Cnda", "rudder_side_force": "CYdr", "roll_rate_yaw": "Cnp",
    "yaw_rate_roll": "Clr", "sideslip_cubed_yaw": "Cnbbb",
}  # fmt: skip
SENSORS = {  # channel, size and kind of the error
    "sideslip_bias": ("beta", 0.01, "bias"),
    "roll_rate_scale": ("p", 0.05, "scale"),
    "yaw_rate_bias": ("r", 0.004, "bias"),
    "accel_y_bias": ("ay", 0.15, "bias"),
    "bank_angle_bias": ("phi", 0.02, "bias"),
    "aileron_delay": ("aileron", 0.08, "delay"),
    "rudder_delay": ("rudder", 0.08, "delay"),
}
HIDDEN = (*AERODYNAMIC, *SENSORS, "unknown")


@dataclass(frozen=True)
class _Odd(Plane):
    """A rolling moment that comes and goes with the altitude."""

    odd: float = 0.0

    def loads(self, x: np.ndarray, controls: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        force, moment = super().loads(x, controls)
        pressure = 0.5 * self.density(x[9]) * float(x[:3] @ x[:3]) * self.S
        return force, moment + np.array([pressure * self.b * self.odd * np.sin(x[9] / 3.0), 0.0, 0.0])


def _wrong(x: Float[np.ndarray, " n"], kind: str, size: float, dt: float) -> Float[np.ndarray, " n"]:
    """What the recorder shows of a channel with this error."""
    if kind == "delay":
        index = np.arange(len(x))
        return np.interp(index - size / dt, index, x)
    return (1.0 + size) * x if kind == "scale" else x + size


def case(seed: int) -> dict:
    """Draw, fly, record and diagnose."""
    rng = np.random.default_rng([seed, 21])
    name = None if seed % 4 == 0 else HIDDEN[(seed - seed // 4 - 1) % len(HIDDEN)]
    plane = drawn(rng, **ATTACHED, Cnbbb=-1.5 * rng.uniform(0.7, 1.3) if name == "sideslip_cubed_yaw" else 0.0)
    size = getattr(plane, AERODYNAMIC[name]) if name in AERODYNAMIC else None
    if name == "unknown":
        plane = _Odd(**{n: getattr(plane, n) for n in Plane.__dataclass_fields__}, odd=0.002)
    effects = tuple(e for e in (*LONGITUDINAL, *LATERAL) if e != name)
    flights = [fly(plane, kind, rng) for kind in FLOWN]
    if name in SENSORS:
        channel, usual, kind = SENSORS[name]
        size = usual * rng.uniform(0.8, 1.2)
        flights = [{**flight, channel: _wrong(flight[channel], kind, size, 0.04)} for flight in flights]
    records = [record(f"{FLOWN[i]}_{i}", flight, rng) for i, flight in enumerate(flights)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "another.toml"
        path.write_text(card_text(replace(plane), effects), encoding="utf-8")
        card = read_card(str(path))
    began = time.perf_counter()
    found = diagnose(records, card, seed=seed, gains_wanted=False, process_noise=False)
    causes = {c.name: {p: [s.mean, s.sd] for p, s in c.parameters.items()} for c in found.causes}
    return {
        "seed": seed,
        "hidden": name,
        "size": size,
        "verdict": found.verdict.value,
        "causes": causes,
        "ambiguous": {c.name: c.ambiguous_with for c in found.causes},
        "unexplained": [[u.coefficient, u.channel] for u in found.unknown],
        "seconds": time.perf_counter() - began,
    }


def report(rows: list[dict]) -> None:
    """Counts, what was taken for what, and a line for each that was not named alone."""
    silent = [r for r in rows if r["hidden"] is None]
    print(f"nothing hidden: silent {sum(r['verdict'] == 'no_effect' for r in silent)} of {len(silent)}")
    unknown = [r for r in rows if r["hidden"] == "unknown"]
    print(f"in no catalogue: unexplained {sum(bool(r['unexplained']) for r in unknown)} of {len(unknown)}")
    some = [r for r in rows if r["hidden"] not in (None, "unknown")]
    alone = [r for r in some if list(r["causes"]) == [r["hidden"]] and r["verdict"] == "explained"]
    print(f"one effect: named {sum(r['hidden'] in r['causes'] for r in some)} of {len(some)}, alone {len(alone)}")
    inside = [abs(m - r["size"]) < 1.96 * s for r in alone for m, s in list(r["causes"][r["hidden"]].values())[:1]]
    print(f"its 95 % interval holds the size {sum(inside)} of {len(inside)}")
    for (hidden, taken), count in sorted(Counter((r["hidden"], tuple(r["causes"])) for r in some).items()):
        print(f"  {hidden}: {', '.join(taken) or 'nothing'} ({count})")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("lateral"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path = given.out / "lateral.jsonl"
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    with path.open("a") as file:
        for seed in range(given.first, given.first + given.count):
            if seed not in {row["seed"] for row in done}:
                done.append(case(seed))
                give_back_memory()
                file.write(json.dumps(done[-1]) + "\n")
                file.flush()
    report(done)
