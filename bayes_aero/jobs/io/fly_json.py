"""A fit to trajectories with its findings, and the file that holds it, trajectories.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from bayes_aero.diagnosis.trajectories.results import Disagreement, Motion, ProcessNoise, TrajectoryFit
from bayes_aero.flight.agreement import Consistency
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health import HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.posterior.posterior import Posterior
from bayes_aero.inference.scores import OneStep, Predicted
from bayes_aero.jobs.io.consistency_json import consistency_results, health_results
from bayes_aero.jobs.io.diagnosis_json import record_results
from bayes_aero.jobs.io.identification_json import frequency_results, inseparable_results, posterior_results
from bayes_aero.jobs.io.trajectories_json import motion_results, open_loop
from bayes_aero.jobs.options import FIXED, FREE, HELD, LINEAR
from bayes_aero.report.tables.fly import parameter_rows

SCHEMA = "bayes_aero/trajectories/5"
RESULTS = "trajectories.json"


@dataclass(frozen=True)
class Flight:
    """A fit to trajectories with its findings, in SI and radians.

    `flown.fit` has estimates (k,), standard errors and `det_R`. `sentences` are the findings, `notes` remarks on the
    input, `failures` parts that failed unexpectedly, `apart` parameters for which the coefficients of the same record
    give other values, `posteriors` those of the fit with process noise, by sampler (`nuts`, `emcee`), `motion` modes
    of motion of a fit that converged.
    """

    flown: TrajectoryFit
    sentences: tuple[str, ...]
    notes: tuple[str, ...]
    health: tuple[HealthFinding, ...] = ()
    consistency: Consistency | None = None
    failures: tuple[str, ...] = ()
    apart: tuple[Disagreement, ...] = ()
    process_noise: ProcessNoise | None = None
    posteriors: Mapping[str, Posterior] = field(default_factory=dict)
    motion: Motion | None = None


def fly_results(found: Flight, card: Card, records: Sequence[FlightRecord], source: dict[str, Any]) -> dict[str, Any]:
    """trajectories.json: plain numbers and text, SI and radians (schemas/trajectories.schema.json)."""
    flown = found.flown
    fit = flown.fit
    states = fit.flown.dynamics.start
    units = {name: flown.units.get(name, "1") for name in states}
    beliefs = flown.departure_sd
    return {
        "schema": SCHEMA,
        "card": {"name": card.name, "title": card.title},
        "records": record_results(records, card),
        "consistency": {} if found.consistency is None else consistency_results(found.consistency),
        "status": fit.status.name.lower(),
        "converged": flown.converged,
        "sentences": list(found.sentences),
        "fitted_outputs": list(fit.flown.outputs),
        "windows": flown.window,
        "setting": {
            "initial_state": FREE if flown.setting.initial is None else FIXED,
            "priors": flown.setting.priors,
            "inputs": HELD if flown.setting.held else LINEAR,
        },
        "iterations": fit.iterations,
        "cost": fit.cost,
        "det_R": fit.det_R,
        "variance_inflation": flown.variance_inflation,
        "noise_growth": dict(flown.noise_growth),
        "parameters": parameter_rows(flown),
        "covariance": fit.corrected,
        "inseparable": inseparable_results(flown.fit.inseparable),
        "disagreement": [asdict(d) for d in found.apart],
        **({} if found.process_noise is None else {"process_noise": _process_noise(found.process_noise)}),
        **({"posterior": posterior_results(found.posteriors)} if found.posteriors else {}),
        **({"frequency": [frequency_results(fit) for fit in flown.frequency]} if flown.frequency else {}),
        **({} if found.motion is None else {"motion": motion_results(found.motion)}),
        "initial_states": {
            manoeuvre: {
                n: {"value": x, "departure": d, "unit": units[n], "prior_sd": beliefs.get(n)}
                for n, (x, d) in states.items()
            }
            for manoeuvre, states in flown.initial.items()
        },
        "residual_sd": dict(zip(fit.flown.outputs, np.sqrt(fit.R), strict=True)),
        "tolerances": {
            name: {"value": t.value, "unit": flown.units[name], "source": t.source}
            for name, t in card.tolerances.items()
            if name in flown.outputs
        },
        "paths": [open_loop(path, flown.units) for path in flown.paths],
        "health": health_results(found.health),
        "notes": list(found.notes),
        "failures": list(found.failures),
        "provenance": source,
    }


def _process_noise(found: ProcessNoise) -> dict[str, Any]:
    """All but the histories, which gusts.csv has."""
    bare = asdict(replace(found, one_step=None, histories=()))
    told = {name: value for name, value in bare.items() if name != "histories"}
    return told | {"one_step": None if found.one_step is None else _one_step(found.one_step)}


def _one_step(found: OneStep) -> dict[str, Any]:
    def told(one: Predicted) -> dict[str, Any]:
        return {
            "innovations": one.count,
            "rms": one.rms,
            "ratio": one.ratio,
            "shares": [asdict(share) for share in one.shares],
            "status": one.calibration.value,
        }

    outputs = {name: told(one) for name, one in found.outputs.items()}
    together = {key: value for key, value in told(found.together).items() if key != "rms"}
    return {"status": found.status, "outputs": outputs, "together": together}
