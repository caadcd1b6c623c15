"""A fit to trajectories with its findings, and the file that holds it, trajectories.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from msgspec import UNSET

from bayes_aero.diagnosis.trajectory_result import Disagreement, Motion, ProcessNoise, TrajectoryFit
from bayes_aero.flight.card import Card
from bayes_aero.flight.health.finding import Consistency, HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.results import Posterior
from bayes_aero.jobs.io import documents as parts
from bayes_aero.jobs.io.diagnosis_json import path_part, record_parts, stated_tolerances
from bayes_aero.jobs.io.identification_json import frequency_part, inseparable_parts, posterior_parts
from bayes_aero.jobs.options import FIXED, FREE, HELD, LINEAR
from bayes_aero.jobs.provenance import picked
from bayes_aero.report.pages.fly import parameter_rows

SCHEMA = "bayes_aero/trajectories/5"
RESULTS = "trajectories.json"
SAMPLERS = ("nuts", "emcee")  # the file is written when the first has ended, too


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


def fly_results(
    found: Flight, card: Card, records: Sequence[FlightRecord], source: dict[str, Any]
) -> parts.TrajectoriesDocument:
    """trajectories.json: plain numbers and text, SI and radians."""
    flown, fit = found.flown, found.flown.fit
    setting, beliefs = flown.setting, flown.departure_sd
    return parts.TrajectoriesDocument.of(
        flown,
        schema=SCHEMA,
        card=card,
        records=record_parts(records, card),
        consistency=parts.ConsistencyPart.of(found.consistency),
        status=fit.status.name.lower(),
        sentences=found.sentences,
        fitted_outputs=fit.flown.outputs,
        setting=parts.SettingPart(
            FREE if setting.initial is None else FIXED, setting.priors, HELD if setting.held else LINEAR
        ),
        **picked(fit, "iterations", "cost", "det_R"),
        parameters=parameter_rows(flown),
        covariance=fit.corrected,
        inseparable=inseparable_parts(fit.inseparable),
        disagreement=found.apart,
        process_noise=UNSET if found.process_noise is None else found.process_noise,
        posterior=parts.FlownPosterior.of(**dict.fromkeys(SAMPLERS, UNSET) | posterior_parts(found.posteriors))
        if found.posteriors
        else UNSET,
        frequency=[frequency_part(fit) for fit in flown.frequency] or UNSET,
        motion=UNSET if found.motion is None else motion_part(found.motion),
        initial_states={
            manoeuvre: {n: parts.InitialState(*x, flown.units.get(n, "1"), beliefs.get(n)) for n, x in states.items()}
            for manoeuvre, states in flown.initial.items()
        },
        residual_sd=dict(zip(fit.flown.outputs, np.sqrt(fit.R), strict=True)),
        tolerances=stated_tolerances(card, {name: flown.units[name] for name in flown.outputs}),
        paths=[path_part(parts.FlownPath, path, flown.units) for path in flown.paths],
        **picked(found, "health", "notes", "failures"),
        provenance=source,
    )


def motion_part(found: Motion) -> parts.MotionPart:
    """Modes of motion, SI and radians."""
    modes = [
        parts.ModePart.of(mode, eigenvalue=(mode.eigenvalue.real, mode.eigenvalue.imag), **mode.quantities)
        for mode in found.modes
    ]
    return parts.MotionPart.of(found, estimates="process noise" if found.filtered else "output error", modes=modes)
