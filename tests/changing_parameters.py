"""Simulated pairs of manoeuvres in which a parameter of the aircraft takes another value halfway through the second."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.record import FlightRecord
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.simulate.demo import DT, MARGIN
from bayes_aero.simulate.injection import Beyond, hidden_records

AT = 43.0  # s from the begin of the record


def _effect(name: str, stage: Stage, channels: tuple[str, ...], increments: Any) -> Effect:
    parameter = Parameter(f"change_{name}", "-", 0.0, 0.0, "change of a parameter", Prior("normal", 0.0, 1.0))
    return Effect(
        name, Kind.AERODYNAMICS, stage, name, (parameter,), ("time", *channels), increments, Example({}, {}, {}, ""), ""
    )


def _late(s: Any) -> Any:
    return jnp.where(s["time"] >= AT + MARGIN * DT, 1.0, 0.0)


CHANGES = (
    _effect("Cm0", Stage.TOTAL, (), lambda v, s, *_: {"Cm": v["change_Cm0"] * _late(s)}),
    _effect(
        "CLaM",
        Stage.ATTACHED,
        ("alpha", "mach"),
        lambda v, s, *_: {"CL_attached": v["change_CLaM"] * s["mach"] * s["alpha"] * _late(s)},
    ),
)
"""One program for all changes; where none is hidden it is the same."""


def changed(parameter: str | None, size: float, *, seed: int, **options: Any) -> list[FlightRecord]:
    """Two records of one aircraft, whose `parameter` (Cm0, CLaM; None: none) grows by `size` after `AT` s of the second
    one. Options as of `hidden_flights`."""

    def flown(values: dict[str, float]) -> list[FlightRecord]:
        return hidden_records({}, seed=seed, beyond=Beyond(CHANGES, lambda _: values), **options)

    before = flown({})
    if parameter is None:
        return before
    return [before[0], flown({f"change_{parameter}": size})[1]]
