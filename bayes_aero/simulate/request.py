"""A synthetic record as it is asked for: what may be asked, and the samples that it takes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from bayes_aero.dynamics.simulated.rigid_manoeuvres import LATERAL
from bayes_aero.errors import InputError
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.card.card import Card
from bayes_aero.simulate.manoeuvres import DT, LONGEST

NOISES = ("none", "white", "ar1", "buffet")
RANDOM_STALL = "random_stall"
MANOEUVRES = (
    RANDOM_STALL, "slow_stall", "elevator_doublet", "elevator_3211", "multisine", "thrust_steps", "speed_change",
    "sideslip", "bank_to_bank", "stabilizer_steps", *LATERAL,
)  # fmt: skip
SECONDS = {RANDOM_STALL: 90.0}
USUAL_SECONDS = 60.0
SHORTEST, MOST_SAMPLES = 5.0, 200_000
BEFORE, AFTER = 5.0, 2.0  # s flown beyond both ends: to settle, and for what reaches across them

Chosen = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Request:
    """What to simulate: `effects` by name with true values (SI), the manoeuvre, its noise and sampling (s).

    `amplitude` multiplies the inputs of a standard manoeuvre.
    """

    effects: Chosen
    manoeuvre: str = RANDOM_STALL
    noise: str = "ar1"
    noise_scale: float = 1.0
    seed: int = 0
    duration: float | None = None
    dt: float = DT
    airspeed: float | None = None
    altitude: float = 5200.0
    amplitude: float = 1.0

    @property
    def seconds(self) -> float:
        """Length of the record."""
        return self.duration or SECONDS.get(self.manoeuvre, USUAL_SECONDS)


@dataclass(frozen=True)
class Grid:
    """Times of all samples that are flown, s, those of them that are recorded, and their interval, s."""

    time: Float[np.ndarray, " n"]
    kept: slice
    dt: float

    @property
    def n(self) -> int:
        """Samples flown."""
        return len(self.time)


def refuse(request: Request, card: Card) -> None:
    """`InputError` where no such record can be made."""
    if card.linear is not None:
        raise InputError(f"card {card.name} states a linear system; simulate flies cards with [aircraft] and [model]")
    if request.manoeuvre not in MANOEUVRES:
        raise InputError(f"there is no manoeuvre {request.manoeuvre!r}; use one of {', '.join(MANOEUVRES)}")
    if request.manoeuvre in LATERAL and Axis.LATERAL not in card.axes:
        raise InputError(
            f"a {request.manoeuvre} needs a card that models the lateral axis; card {card.name} has "
            f'[model] axes {list(map(str, card.axes))}: add "lateral"'
        )
    if request.noise not in NOISES:
        raise InputError(f"there is no noise {request.noise!r}; use one of {', '.join(NOISES)}")
    if not 0.002 <= request.dt <= 0.1:
        raise InputError(f"a sampling interval of {request.dt:g} s was asked for; give one from 0.002 to 0.1 s")
    most = LONGEST if request.manoeuvre == RANDOM_STALL else MOST_SAMPLES * request.dt
    if not SHORTEST <= request.seconds <= most:
        raise InputError(
            f"a {request.manoeuvre} of {request.seconds:g} s was asked for; ask for {SHORTEST:g} to {most:g} s"
        )
    if not (np.isfinite(request.noise_scale) and request.noise_scale >= 0.0):
        raise InputError(f"the noise scale is {request.noise_scale}; it must be zero or more")
    if not 0.0 < request.amplitude <= 5.0:
        raise InputError(f"an amplitude of {request.amplitude:g} was asked for; it must be positive, at most 5")
    if not -500.0 <= request.altitude <= 11_000.0:
        raise InputError(f"an altitude of {request.altitude:g} m was asked for; the simulated air ends at 11000 m")


def grid_of(request: Request) -> Grid:
    """Time of every sample that is flown, s; the record begins at 0."""
    dt, before = request.dt, 2.0 if request.manoeuvre == RANDOM_STALL else BEFORE
    first, kept, last = round(before / dt), round(request.seconds / dt) + 1, round(AFTER / dt)
    return Grid((np.arange(first + kept + last) - first) * dt, slice(first, first + kept), dt)
