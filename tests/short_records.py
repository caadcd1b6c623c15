"""Short records of another aircraft, with channels and entries of its card left out: what most users begin with.

Flown by the simulator in `stranger`: some seconds of a 3-2-1-1 or of a stall, sampled as a recorder may.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from stranger import Plane, fly, plane
from stranger_records import NOISE

UNITS = {
    "time": "s", "airspeed": "m/s", "alpha": "rad", "theta": "rad", "q": "rad/s", "ax": "m/s^2", "az": "m/s^2",
    "altitude": "m", "elevator": "rad", "thrust": "N", "p": "rad/s", "r": "rad/s",
}  # fmt: skip
OPTIONAL = ("theta", "altitude", "p", "r", "ax", "az", "thrust", "elevator")
HELD = {"density": "0.95 kg/m^3", "thrust": "3000 N", "p": "0 rad/s", "r": "0 rad/s"}
ATTACHED = (
    "attached_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag",
)  # fmt: skip
STALL = ("flow_separation", "kirchhoff_lift", "separated_drag", "separated_moment")
SECTIONS = {
    "sensors": 'alpha = "0.05 deg"\nq = "0.05 deg/s"\nax = "0.02 m/s^2"',
    "tolerances": 'alpha = "1 deg"\nq = "1 deg/s"',
    "output_biases": 'alpha = "0.5 deg"',
    "gp": 'inputs = ["alpha", "alpha", "q"]',
    "parameters.CL0": "start = 0.3",
}
RATES, LENGTHS = (5.0, 10.0, 20.0, 25.0, 50.0, 100.0), (6.0, 8.0, 12.0, 14.0, 18.0, 25.0)


@dataclass(frozen=True)
class Short:
    """What is flown from `begin` s on, what is recorded of it, and what its card says."""

    rate: float
    seconds: float
    begin: float = 2.0
    records: int = 1
    without: tuple[str, ...] = ()
    constants: Mapping[str, str] = field(default_factory=dict)
    derived: tuple[str, ...] = ()
    effects: tuple[str, ...] = ATTACHED
    sections: tuple[str, ...] = ()
    noise: float = 1.0
    seed: int = 0

    def write(self, folder: Path) -> tuple[list[Path], Path]:
        """Its records and its card."""
        rng, dt = np.random.default_rng(self.seed), 1.0 / self.rate
        aircraft, files = plane(rng), []
        for number in range(self.records):
            rows = fly(aircraft, rng, dt, seconds=self.begin + self.seconds + 1.0)
            rows = rows[:, round(self.begin / dt) :][:, : round(self.seconds / dt) + 1]
            rows = rows + self.noise * np.array(NOISE)[:, None] * rng.standard_normal(rows.shape)
            still = 9e-4 * rng.standard_normal((2, rows.shape[1]))
            order = ("time", "airspeed", "alpha", "theta", "q", "ax", "az", "altitude", "elevator", "thrust", "p", "r")
            columns = {name: x for name, x in zip(order, (*rows, *still), strict=True) if name not in self.without}
            files.append(folder / f"run{number}.csv")
            table = np.array(list(columns.values())).T
            np.savetxt(files[-1], table, delimiter=",", header=",".join(columns), comments="", fmt="%.8g")
        (folder / "card.toml").write_text(self._card(aircraft))
        return files, folder / "card.toml"

    def _card(self, p: Plane) -> str:
        channels = [f'{n} = {{ label = "{n}", unit = "{u}" }}' for n, u in UNITS.items() if n not in self.without]
        return "\n".join(
            [
                'title = "short records"',
                "[aircraft]",
                f'mass = "{p.mass} kg"',
                *(f'{name} = "{p.Iy} kg m^2"' for name in ("Ix", "Iy", "Iz")),
                'Ixz = "0 kg m^2"',
                f'wing_area = "{p.S} m^2"',
                f'chord = "{p.c} m"',
                f'half_span = "{p.b / 2.0} m"',
                f"aspect_ratio = {p.b**2 / p.S}",
                f'tail_arm = "{p.tail} m"',
                "[channels]",
                *channels,
                *_section("constants", [f'{name} = "{value}"' for name, value in self.constants.items()]),
                *_section("derived", [f'{name} = "standard atmosphere"' for name in self.derived]),
                *(line for name in self.sections for line in _section(name, [SECTIONS[name]])),
                "[model]",
                f"effects = {json.dumps(self.effects)}",
                "",
            ]
        )


def _section(name: str, lines: Sequence[str]) -> list[str]:
    return [f"[{name}]", *lines] if lines else []


def drawn(rng: np.random.Generator) -> Short:
    """Any of them: channels, constants, sections and effects left out at random."""
    without = tuple(name for name in OPTIONAL if rng.random() < 0.1)
    constants = {n: v for n, v in HELD.items() if n in without and rng.random() < 0.85}
    derived = ("density", "mach")[: int(rng.integers(1, 3))]
    if "altitude" in without or rng.random() < 0.2:
        derived, constants = (), constants | {"density": HELD["density"]}
    flat = {"phi": "0 deg", "beta": "0 deg", "ay": "0 m/s^2"}
    effects = tuple(e for e in ATTACHED if e != "elevator_moment" or "elevator" not in without)
    if rng.random() < 0.3:
        effects = tuple(str(e) for e in rng.permutation(effects)[: int(rng.integers(1, 5))])
    if rng.random() < 0.3:
        effects += (*STALL, *(("separation_lag",) if rng.random() < 0.3 else ()))
    sections = tuple(name for name in SECTIONS if rng.random() < 0.3)
    return Short(
        rate=float(rng.choice(RATES)),
        seconds=float(rng.choice(LENGTHS)),
        begin=float(rng.choice([2.0, 4.0, 10.0, 16.0, 30.0])),
        records=int(rng.choice([1, 1, 2])),
        without=without,
        constants=constants | {n: v for n, v in flat.items() if rng.random() < 0.4},
        derived=derived,
        effects=effects,
        sections=tuple(s for s in sections if s != "parameters.CL0" or "attached_lift" in effects),
        noise=float(rng.choice([0.0, 1.0, 1.0, 3.0])),
        seed=int(rng.integers(1 << 30)),
    )
