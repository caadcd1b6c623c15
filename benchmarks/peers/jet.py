"""Output error: ours and aeroid 0.5 on phugoid and short period of a small jet, the problem of output_error_speed.py.

600 samples, 4 states, 6 outputs, 11 parameters, all from one start that is wrong by up to 15 %. aeroid is given the
initial state and the weights of the optimum, which ours has to find. Judged by (n/2) log det R in one simulation.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from contender import Problem

if TYPE_CHECKING:
    import aeroid

    from bayes_aero.inference.likelihood.output_error_result import OutputErrorResult

JET = "jet.pickle"


@dataclass(frozen=True)
class Jet:
    """What aeroid is given, in plain NumPy; arrays of parameters follow `names`."""

    time: np.ndarray
    channels: dict[str, np.ndarray]
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    names: tuple[str, ...]
    start: np.ndarray
    estimate: np.ndarray
    begin: np.ndarray  # initial state at the optimum, (4,)
    sigma: dict[str, float]  # deviations of the outputs' residuals there
    aircraft: SimpleNamespace
    gravity: float


class Found(NamedTuple):
    """Parameters and initial state of a fit."""

    theta: np.ndarray
    begin: np.ndarray


def prepare_jet(folder: Path) -> None:
    """Simulate the record, fit it and put it into `folder`."""
    import output_error_speed as race

    flown, aircraft = race.problem()
    fit = our_fit(flown)
    reference = race.Reference(flown, aircraft, fit)
    channels = {name: np.asarray(x) for name, x in flown.flights.channels.items()}
    outputs = (*race.STATES, "ax", "az")
    constants = ("mass", "Iy", "wing_area", "chord", "engine", "engine_inclination", "reference_speed", "rate_length")
    jet = Jet(
        time=np.arange(race.N) * race.DT,
        channels={name: channels[name] for name in (*outputs, "elevator", "thrust")},
        states=race.STATES,
        outputs=outputs,
        names=fit.names,
        start=race.wrong_start(fit.names),
        estimate=fit.estimate,
        begin=reference.begin + fit.departure[0],
        sigma=dict(zip(outputs, (1.0 / reference.weight).tolist(), strict=True)),
        aircraft=SimpleNamespace(**{name: plain(getattr(aircraft, name)) for name in constants}),
        gravity=race.GRAVITY,
    )
    (folder / JET).write_bytes(pickle.dumps(jet))


def plain(value):
    """A number, or a tuple of them."""
    return tuple(map(float, value)) if isinstance(value, tuple) else float(value)


def our_fit(flown) -> OutputErrorResult:
    """From the wrong start."""
    from output_error_speed import wrong_start

    from bayes_aero.inference.likelihood.output_error import fit_output_error

    return fit_output_error(flown, start=wrong_start(flown.dynamics.names))


def jet_of(problem: Problem) -> Jet:
    """What `prepare_jet` has left."""
    return pickle.loads((problem.folder / JET).read_bytes())


def ours(problem: Problem, _: int, __: argparse.Namespace) -> Callable[[int], Found]:
    """Parameters, initial state and covariance of the noise."""
    from output_error_speed import problem as jet_problem

    flown, _ = jet_problem()
    begin = jet_of(problem).begin

    def run(_: int) -> Found:
        return Found(our_fit(flown).estimate, begin)  # whose initial state is its own optimum, too

    return run


def aeroid_problem(jet: Jet, how: str) -> tuple[aeroid.Model, aeroid.FlightData]:
    """Model and data; `how` is "fd" or "jax"."""
    import aeroid
    from aeroid_jet import jet_model

    xp = np
    if how == "jax":
        import jax
        import jax.numpy as xp

        jax.config.update("jax_enable_x64", True)
    parameters = dict(zip(jet.names, map(float, jet.start), strict=True))
    model = jet_model(xp, jet.aircraft, jet.gravity, jet.states, parameters)
    return model, aeroid.FlightData(jet.time, jet.channels)


def aeroid_with(how: str, kept: bool = False) -> Callable[[Problem, int, argparse.Namespace], Callable[[int], Found]]:
    """aeroid.identify, with its differences or JAX's gradient, which it compiles in every call unless it is `kept`."""

    def prepared(problem: Problem, _: int, __: argparse.Namespace) -> Callable[[int], Found]:
        import aeroid
        from aeroid_jet import KeptRollout

        jet = jet_of(problem)
        model, data = aeroid_problem(jet, how)
        held = KeptRollout() if kept else nullcontext
        weights = {name: 1.0 / sigma for name, sigma in jet.sigma.items()}

        def run(_: int) -> Found:
            with held():
                found = aeroid.identify(model, data, list(jet.names), gradient=how, weights=weights, x0=jet.begin)
            return Found(np.array([found.parameters[name] for name in jet.names]), jet.begin)

        return run

    return prepared


def judge(problem: Problem, _: int, warm: list[tuple[float, Found]]) -> dict[str, float]:
    """The cost reached, nats."""
    from output_error_speed import numpy_response

    jet, (theta, begin) = jet_of(problem), warm[-1][1]
    channels = jet.channels
    flown = numpy_response(theta, begin, jet.names, jet.aircraft, channels["elevator"], channels["thrust"])
    measured = np.stack([channels[name] for name in jet.outputs])
    R = np.mean((measured - flown) ** 2, axis=1)
    return {"cost": float(0.5 * measured.shape[1] * np.sum(np.log(R)))}


CONTENDERS = {
    "bayes_aero": ours,
    "aeroid, its differences": aeroid_with("fd"),
    "aeroid, JAX gradient": aeroid_with("jax"),
    "the same, kept compiled by us": aeroid_with("jax", kept=True),
}
