"""A fit to trajectories with its findings, and the file that holds it, trajectories.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bayes_aero.diagnosis.trajectory_result import Disagreement, Motion, ProcessNoise, TrajectoryFit
from bayes_aero.flight.card import Card
from bayes_aero.flight.health.finding import Consistency, HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.results import Posterior
from bayes_aero.jobs.io.consistency_json import consistency_results
from bayes_aero.jobs.io.diagnosis_json import path_results, record_results, tolerance_results
from bayes_aero.jobs.io.identification_json import frequency_results, inseparable_results, posterior_results
from bayes_aero.jobs.options import FIXED, FREE, HELD, LINEAR
from bayes_aero.jobs.provenance import named_pairs, picked
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
    flown, fit = found.flown, found.flown.fit
    beliefs = flown.departure_sd
    parts: dict[str, Any] = {}
    if found.process_noise is not None:
        parts["process_noise"] = process_noise_results(found.process_noise)
    if found.posteriors:
        parts["posterior"] = posterior_results(found.posteriors)
    if flown.frequency:
        parts["frequency"] = [frequency_results(fit) for fit in flown.frequency]
    if found.motion is not None:
        parts["motion"] = motion_results(found.motion)
    return {
        "schema": SCHEMA,
        "card": picked(card, "name", "title"),
        "records": record_results(records, card),
        "consistency": consistency_results(found.consistency),
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
        **picked(fit, "iterations", "cost", "det_R"),
        **picked(flown, "variance_inflation", "noise_growth"),
        "parameters": parameter_rows(flown),
        "covariance": fit.corrected,
        "inseparable": inseparable_results(fit.inseparable),
        "disagreement": list(found.apart),
        **parts,
        "initial_states": {
            manoeuvre: {
                n: {"value": x, "departure": d, "unit": flown.units.get(n, "1"), "prior_sd": beliefs.get(n)}
                for n, (x, d) in states.items()
            }
            for manoeuvre, states in flown.initial.items()
        },
        "residual_sd": dict(zip(fit.flown.outputs, np.sqrt(fit.R), strict=True)),
        "tolerances": tolerance_results(card, {name: flown.units[name] for name in flown.outputs}),
        "paths": [path_results(path, flown.units, alone=True) for path in flown.paths],
        **picked(found, "health", "notes", "failures"),
        "provenance": source,
    }


def process_noise_results(found: ProcessNoise) -> dict[str, Any]:
    """All but the histories, which gusts.csv has."""
    names = ("status", "converged", "gain", "estimates", "F", "noise_sd", "autocorrelation", "gusts", "covariance")
    told: dict[str, Any] = picked(found, *names) | {"one_step": None}
    if (one_step := found.one_step) is not None:
        rows = ("innovations=count", "rms", "ratio", "shares", "status=calibration")
        told["one_step"] = {
            "status": one_step.status,
            "outputs": {name: picked(one, *rows) for name, one in one_step.outputs.items()},
            "together": picked(one_step.together, *(row for row in rows if row != "rms")),
        }
    return told


def motion_results(found: Motion) -> dict[str, Any]:
    """Modes of motion for trajectories.json: plain numbers and text, SI and radians."""
    return {
        **picked(found, "airspeed", "altitude"),
        "estimates": "process noise" if found.filtered else "output error",
        "modes": [
            {
                "name": mode.name,
                "eigenvalue": [mode.eigenvalue.real, mode.eigenvalue.imag],
                "eigenvalue_sd": list(mode.sd),
                **named_pairs(mode.quantities, "value", "sd"),
            }
            for mode in found.modes
        ],
        "why_no_modes": found.why_not,
    }
