"""The ranges inside which a flight test is proposed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_aero.flight.tolerances import GRAVITY
from bayes_aero.units import number

UNITS = {
    "alpha": "rad", "beta": "rad", "phi": "rad", "airspeed": "m/s", "load_factor": "1", "altitude_loss": "m",
}  # fmt: skip
DEFAULT_RANGES = {
    "alpha": (-0.1, 0.45),
    "beta": (-0.35, 0.35),
    "phi": (-1.2, 1.2),
    "airspeed": (15.0, 300.0),
    "load_factor": (0.0, 2.5),  # 14 CFR 25.337(b): the least limit load factor of a transport; the others: our choice
    "altitude_loss": (-np.inf, 1500.0),
}


@dataclass(frozen=True)
class Envelope:
    """Least and greatest value of each quantity, SI; `stated`: by the card, of these quantities.

    `programmed_inputs`: the aircraft can fly inputs that a computer gives, such as multisines.
    """

    ranges: Mapping[str, tuple[float, float]] = field(default_factory=lambda: dict(DEFAULT_RANGES))
    stated: tuple[str, ...] = ()
    programmed_inputs: bool = False

    def left_by(self, excursion: Mapping[str, tuple[float, float]]) -> str | None:
        """The first quantity outside its range, in words; None where all are inside."""
        for name, (lower, upper) in self.ranges.items():
            if name not in excursion:
                continue
            least, most = excursion[name]
            if not (np.isfinite(least) and np.isfinite(most) and least >= lower and most <= upper):
                return f"{name} {number(least)} to {number(most)} (allowed {number(lower)} to {number(upper)})"
        return None


def excursion(flight: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Least and greatest value of each quantity of an envelope during a flight of these channels, SI.

    The load factor is -az/g, of the specific force along the body's z axis.
    """
    found = {name: np.asarray(flight[name]) for name in ("alpha", "beta", "phi", "airspeed") if name in flight}
    if "az" in flight:
        found["load_factor"] = -np.asarray(flight["az"]) / GRAVITY
    if "altitude" in flight:
        found["altitude_loss"] = np.asarray(flight["altitude"])[0] - np.asarray(flight["altitude"])
    return {name: (float(np.min(x)), float(np.max(x))) for name, x in found.items()}
