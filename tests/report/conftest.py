"""A small identification made by hand, so that every number in a table or sentence is known beforehand."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import arviz_base as azb
import jax.numpy as jnp
import numpy as np
import pytest
from simulated_halves import halves

from bayes_aero.diagnosis.diagnose import with_stalls
from bayes_aero.flight.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.gp import GPFit, make_splits
from bayes_aero.inference.mle import stall_of
from bayes_aero.inference.results import (
    GPReport,
    Identification,
    Marginal,
    MleResult,
    MleStatus,
    Posterior,
    PosteriorStatus,
    Validation,
    score,
)
from bayes_aero.inference.sampling import pit_of
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Colour, Noise, Observations
from bayes_aero.physics.aircraft import NAMES

EFFECTS = ("attached_lift", "elevator_moment", "pitching_moment", "profile_drag")
TRUTH = {"CL0": 0.2, "CLa": 4.0, "Cmde": -0.8, "Cm0": 0.05, "Cma": -0.5, "CD0": 0.04}
CRB = 0.01  # of every parameter
N = 150  # samples a manoeuvre


def observations(model: Model, manoeuvres: int) -> Observations:
    """Slow oscillations at 25 Hz, a manoeuvre each, with a little noise on the coefficients."""
    rng = np.random.default_rng(1)
    t = np.tile(0.04 * np.arange(N), manoeuvres)
    number = np.repeat(np.arange(manoeuvres), N)
    start = np.tile(np.arange(N) == 0, manoeuvres)
    signals = {"alpha": 0.1 + 0.05 * np.sin(2.0 * t + number), "alpha_dot": 0.1 * np.cos(2.0 * t + number)}
    signals |= {"elevator": 0.05 * np.sin(3.0 * t), "dt": np.full(t.size, 0.04)}
    signals = {k: jnp.asarray(v) for k, v in signals.items()}
    aircraft = read_card("attas").aircraft
    theta = jnp.asarray([TRUTH[n] for n in model.names])
    clean = model.predicted(theta, signals, aircraft)
    measured = clean + 0.005 * jnp.asarray(rng.standard_normal((t.size, 3)))
    names = tuple(f"flight{i + 1}" for i in range(manoeuvres))
    return Observations(
        signals=signals, measured=measured, start=jnp.asarray(start), manoeuvre=number, time=t, aircraft=aircraft,
        names=names,
    )  # fmt: skip


def records_of(o: Observations) -> tuple[FlightRecord, ...]:
    """Records with a few of the channels that figure 1 shows."""
    records = []
    for i, name in enumerate(o.names):
        mine = o.manoeuvre == i
        channels = {k: np.asarray(o.signals[k])[mine] for k in ("alpha", "elevator")}
        channels |= {"airspeed": np.full(N, 90.0), "thrust_left": np.full(N, 1e3), "thrust_right": np.full(N, 2e3)}
        records.append(FlightRecord.from_arrays(name, o.time[mine], channels))
    return tuple(records)


def fit(
    model: Model,
    *,
    shift: Mapping[str, float] | None = None,
    corrected: float = 1.0,
    lag1: float = 0.0,
    status: MleStatus = MleStatus.CONVERGED,
) -> MleResult:
    """An estimate `shift` Cramer-Rao deviations off the truth, its corrected bound `corrected` times the other."""
    k = len(model.names)
    estimate = np.array([TRUTH[n] + CRB * (shift or {}).get(n, 0.0) for n in model.names])
    return MleResult(
        parameters=model.free, estimate=estimate, covariance=CRB**2 * np.eye(k), R=np.full(3, 2.5e-5), status=status,
        corrected=(corrected * CRB) ** 2 * np.eye(k), iterations=4, at_bound=(), eigenvalues=np.ones(k),
        separation=(1.0, 1.0), fit={n: score(np.arange(5.0), np.arange(5.0) + 0.1) for n in NAMES},
        lag1=dict.fromkeys(NAMES, lag1), starts=((0.0, "converged"),),
    )  # fmt: skip


def sampled(
    model: Model,
    colour: Colour,
    engine: str,
    *,
    shift: Mapping[str, float] | None = None,
    width: float = 1.0,
    status: PosteriorStatus = PosteriorStatus.CONVERGED,
) -> Posterior:
    """Normal draws, mean `shift` Cramer-Rao deviations off the truth and deviation exactly `width` times the bound."""
    rng = np.random.default_rng(len(engine))
    parameters = (*model.free, *Noise(colour).parameters)
    posterior, prior, marginals = {}, {}, {}
    for p in parameters:
        centre = TRUTH.get(p.name, p.start) + CRB * (shift or {}).get(p.name, 0.0)
        sd = width * CRB if p.name in TRUTH else 0.1 * p.start
        z = rng.standard_normal((4, 120))
        posterior[p.name] = centre + sd * (z - z.mean()) / z.std()
        prior[p.name] = p.prior.sample(rng, 400)[None]
        marginals[p.name] = Marginal(centre, sd, (centre - 1.96 * sd, centre + 1.96 * sd), 1000.0, 900.0, 1.001)
    tree = azb.from_dict({"posterior": posterior, "prior": prior})
    return Posterior(engine, colour.value, tuple(p.name for p in parameters), tree, marginals, status, 1.0)


def validation(o: Observations, test: np.ndarray, column: int, gp_error: float, mle_error: float) -> Validation:
    """Predictions with errors of the given deviation."""
    rng = np.random.default_rng(column)
    measured = np.asarray(o.measured)[test, column]
    gp = measured + gp_error * rng.standard_normal(test.size)
    mle = measured + mle_error * rng.standard_normal(test.size)
    return Validation(
        test=test, measured=measured, gp=gp, gp_low=gp - 0.02, gp_high=gp + 0.02, mle=mle,
        gp_scores=score(measured, gp), mle_scores=score(measured, mle), coverage={0.5: 0.52, 0.9: 0.88, 0.95: 0.94},
        k_hat=0.4, status="accepted",
    )  # fmt: skip


def hyperparameters():
    """A tree as a GP fit leaves it."""
    rng = np.random.default_rng(3)

    def group(size: float, chains: int) -> dict[str, np.ndarray]:
        draws = lambda *shape: np.exp(size * rng.standard_normal((chains, 300, *shape)))
        return {"constant": draws(), "linear": draws(2), "signal": draws(), "length_scale": draws(2), "noise": draws()}

    dims = {"linear": ["input"], "length_scale": ["input"]}
    groups = {"posterior": group(0.3, 2), "prior": group(1.0, 1)}
    tree = azb.from_dict(groups, dims=dims, coords={"input": ["alpha", "elevator"]})
    tree.attrs["k_hat"] = 0.4
    return tree


def gp_fit() -> GPFit:
    """A fit that has its hyperparameters' draws and nothing else: all that reports look at."""
    fit = object.__new__(GPFit)
    object.__setattr__(fit, "posterior", hyperparameters())
    return fit


def gaussian_process(o: Observations, errors: Mapping[str, float], mle_error: float = 0.01) -> GPReport:
    """Every split the records allow; `errors` gives the GP's error by split."""
    kinds: list[Any] = [k for k in ("random", "block", "manoeuvre") if k != "manoeuvre" or len(o.names) > 1]
    splits = {
        kind: [
            {n: validation(o, fold.test_idx, i, errors[kind], mle_error) for i, n in enumerate(NAMES)}
            for fold in make_splits(kind, o.manoeuvre, o.dt, 0, block_seconds=1.0)
        ]
        for kind in kinds
    }
    return GPReport(splits, {n: gp_fit() for n in NAMES}, "random", 1.0)


def build(
    *,
    manoeuvres: int = 2,
    corrected: float = 1.0,
    lag1: float = 0.0,
    width: float = 1.0,
    shift: Mapping[str, float] | None = None,
    apart: Mapping[str, float] | None = None,
    noise: Colour = Colour.AR1,
    engines: Sequence[str] = ("emcee", "nuts", "white"),
    gp_errors: Mapping[str, float] | None = None,
    gp: bool = True,
    status: MleStatus = MleStatus.CONVERGED,
) -> Identification:
    """An identification; `apart` shifts the last manoeuvre's own estimate by so many Cramer-Rao deviations."""
    model = Model.of(EFFECTS)
    o = observations(model, manoeuvres)
    alone = {name: fit(model, corrected=corrected) for name in o.names} if manoeuvres > 1 else {}
    if alone:
        alone[o.names[-1]] = fit(model, shift=apart, corrected=corrected)
    posteriors = {
        key: sampled(model, Colour.WHITE, "emcee")
        if key == "white"
        else sampled(model, noise, key, shift=shift, width=width)
        for key in engines
    }
    mle, first = fit(model, corrected=corrected, lag1=lag1, status=status), next(iter(posteriors.values()), None)
    stall = None if first is None else stall_of(model, first.draws(model.names), o.signals, o.aircraft)
    errors = gp_errors or dict.fromkeys(("random", "block", "manoeuvre"), 0.001)
    run = Identification(
        card=read_card("attas"), model=model, records=records_of(o), observations=o, noise=noise, mle=mle, alone=alone,
        posteriors=posteriors, stall=stall, gp=gaussian_process(o, errors) if gp else None,
    )  # fmt: skip
    return replace(run, pit=pit_of(run))


@pytest.fixture(scope="session")
def make():
    """The factory `build`."""
    return build


@pytest.fixture(scope="session")
def full():
    """Two manoeuvres, three posteriors, a GP, and results that disagree."""
    return build(
        corrected=4.0, lag1=0.9, width=2.0, shift={"Cma": 30.0}, apart={"Cmde": -60.0},
        gp_errors={"random": 0.001, "block": 0.01, "manoeuvre": 0.05},
    )  # fmt: skip


@pytest.fixture(scope="session")
def simulated(full):
    """Trajectories without a diagnosis."""
    return halves(full.records[0])


@pytest.fixture(scope="session")
def flown(diagnosed):
    """The diagnosis with two simulated halves, and with its stalls."""
    return replace(with_stalls(diagnosed.view), trajectories=halves(diagnosed.records[0]))
