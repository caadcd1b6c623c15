"""The job of `bayes-aero qualify`: how probably a finished model passes its tolerances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from bayes_aero.diagnosis.trajectories import FlightNoise, posterior_draws, trajectory_variance_inflation
from bayes_aero.dynamics.flight import Dynamics, aircraft_dynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.errors import InputError
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import repeats_of
from bayes_aero.flight.reading import read_records
from bayes_aero.flight.record import TOLERANCES, FlightRecord
from bayes_aero.inference.mle import MAX_SEPARATE_FITS
from bayes_aero.inference.output_error import fit_output_error
from bayes_aero.jobs.check import record_checks
from bayes_aero.jobs.documents import ConsistencyPart, JudgedTolerance, QualificationDocument, TestPart
from bayes_aero.jobs.finished import FinishedResult, IdentifiedLinear, drawn, read_finished
from bayes_aero.jobs.options import QualifyOptions
from bayes_aero.jobs.store import provenance, writable, write_json
from bayes_aero.model.observations import despiked, join
from bayes_aero.model.records import Flights
from bayes_aero.physics.aircraft import FLIGHT
from bayes_aero.progress import Progress, quiet
from bayes_aero.qualification import FAILS_TO, PASSES_FROM, FlightKind, Further, Outside, Qualification, Strip
from bayes_aero.qualification.qualify import (
    CHANNELS,
    OpenTest,
    Region,
    Uncertain,
    alone_fits,
    fits_without,
    further_flights,
    hold_out,
    next_parameters,
    qualify,
)
from bayes_aero.report.page import put_page
from bayes_aero.report.pages.qualification import qualification_page, test_table
from bayes_aero.report.phrases import several
from bayes_aero.report.table import write_csv

UNSCATTERED = (
    "The errors of every manoeuvre by the fit to the others, which hold the scatter between manoeuvres. The scatter of "
    "their own fits is not used: it would make flights differ by more than those left out did, so it is mostly its "
    "prior."
)


def qualify_result(
    given: str,
    tests: Sequence[Path] = (),
    options: QualifyOptions = QualifyOptions(),
    *,
    out: Path | None = None,
    progress: Progress = quiet,
) -> tuple[Qualification, tuple[str, ...]]:
    """Qualify the model of a finished result, also by `tests` that were not fitted; and sentences on what failed."""
    source = read_finished(given, options.card)
    card, records = source.card, source.records("give it with --fitted", options.fitted)
    new = new_records(tests, records, card, source, options.gusts)
    if out is not None:
        writable(out)
    checks = record_checks([*records, *new], card, options.seed, out, progress=progress)
    with checks.behind():
        flown, bands = _segments(source, card, records)
        tested, _ = _segments(source, card, new, tuple(bands)) if new else (None, {})
        unknown, origins = uncertain(source, flown, options, progress)
        results = qualify(flown, tested, unknown, bands, seed=options.seed, progress=progress)
    outside, region = outside_region(flown, tested, results.strips)
    if results.scattered not in (None, True) and unknown.following is not None:
        origins["next flight"] = UNSCATTERED
    qualification = Qualification(
        tests=results.tests,
        outside=outside,
        channels=region.channels,
        unjudged=tuple(n for n in CHANNELS if n not in region.channels and n != "mach"),
        strips=results.strips,
        tolerances={name: (x, card.tolerances[name].source) for name, x in bands.items()},
        draws=options.draws,
        origins=origins,
        notes=(*source.identified.sources, *limits_of(card, bands, region)),
        further=deciding_flights(source, card, flown, results.undecided, unknown),
        health=checks.health,
        consistency=checks.consistency,
    )
    if out is None:
        return qualification, checks.failures
    settings: dict[str, Any] = {"result": source.file.name, "draws": options.draws, "gusts": options.gusts}
    made = provenance(card, [*records, *new], options.seed, settings, options)
    write_csv(test_table(qualification), out / "qualification.csv")  # numbers first, then the page
    write_json(qualification_results(qualification, card, made, checks.failures), out / RESULTS)
    unmade = put_page(lambda: qualification_page(qualification, card, made), out, "qualification.html")
    failures = (*checks.failures, *unmade)
    if unmade:
        write_json(qualification_results(qualification, card, made, failures), out / RESULTS)
    return qualification, failures


def new_records(
    tests: Sequence[Path], fitted: Sequence[FlightRecord], card: Card, source: FinishedResult, gusts: float | None
) -> list[FlightRecord]:
    """Records that were not fitted, read as those were; refused where they were, or the model cannot fly them."""
    how, linear = fitted[0].read, source.linear
    new = read_records(tests, card.channels, resample=how["resample"], segments=card.segments, split=how["split"])
    for record, before in product(new, fitted):
        if (shared := repeats_of(before, record)) is not None:
            raise InputError(f"{record.name} {shared[0]}; {before.name} was fitted, so it is tested anyway")
    if linear is not None and gusts:
        raise InputError(f"card {linear.name} states a linear system, not flown in moving air; leave --gusts out")
    if linear is not None and new and linear.rows.by_manoeuvre:
        separate = several(linear.rows.by_manoeuvre)
        raise InputError(f"card {linear.name} states {separate} for each manoeuvre; leave {new[0].name} out")
    return new


def deciding_flights(
    source: FinishedResult, card: Card, flown: SegmentTrajectories, undecided: Sequence[OpenTest], unknown: Uncertain
) -> Further | None:
    if not undecided:
        return None
    if isinstance(source.identified, IdentifiedLinear):
        return Further((), why_not="a linear system does not know the forces and moments of other manoeuvres")
    flights, names = flown.flights, list(flown.dynamics.names)
    assert isinstance(flights, Flights)
    values = {name: float(source.identified.values[name]) for name in source.identified.model.names}
    errors = unknown.draws - unknown.estimate
    try:
        return further_flights(undecided, names, errors, flights, source.identified.model, values, card.envelope)
    except InputError as error:
        return Further((), why_not=str(error))


def _segments(
    source: FinishedResult, card: Card, records: Sequence[FlightRecord], outputs: tuple[str, ...] = ()
) -> tuple[SegmentTrajectories, dict[str, float]]:
    """Whole manoeuvres with the outputs that have a tolerance, and half the widths of their bands, SI."""
    identified = source.identified
    if isinstance(identified, IdentifiedLinear):
        flights, _ = despiked(join(records, card, identified.rows.inputs))
        dynamics: Dynamics = identified.dynamics(flights)
    else:
        flights, _ = despiked(join(records, card, FLIGHT))
        dynamics = aircraft_dynamics(identified.model, flights)
    theta = np.array([identified.values[name] for name in dynamics.names])
    there = [n for n in dynamics.outputs if n in flights.channels]
    bands = {n: card.tolerances[n].value for n in there if n in card.tolerances}
    for name in outputs:
        if name not in bands:
            raise InputError(
                f"record {records[0].name} has no channel {name}, which has a tolerance; leave the record out"
            )
    if not bands:
        raise InputError(f"card {card.name} has no tolerance of {', '.join(there)}; state one under [tolerances]")
    chosen = outputs or tuple(bands)
    return segments(flights, dynamics, outputs=chosen, substeps=dynamics.substeps(theta, flights)), bands


def outside_region(
    flown: SegmentTrajectories, tested: SegmentTrajectories | None, strips: Sequence[Strip]
) -> tuple[tuple[Outside, ...], Region]:
    """Where recorded and simulated motions leave the flown region; it has no channels where none was recorded."""
    every = [flown.flights.channels] + ([] if tested is None else [tested.flights.channels])
    shared = set.intersection(*(set(channels) for channels in every))
    region = Region.of({n: np.asarray(x) for n, x in flown.flights.channels.items() if n in shared})
    departures = []
    for strip in strips:
        if strip.kind is FlightKind.NEXT or not region.channels:
            continue
        flights = (tested if strip.kind is FlightKind.TEST and tested is not None else flown).flights
        samples = flights.manoeuvre == flights.names.index(strip.manoeuvre)
        recorded = {n: np.asarray(x)[samples] for n, x in flights.channels.items() if n in region.channels}
        simulated = recorded | {n: x for n, x in strip.simulated.items() if n in recorded}
        if "mach" in recorded and "airspeed" in strip.simulated:  # it goes with the airspeed
            simulated["mach"] = recorded["mach"] * strip.simulated["airspeed"] / strip.measured["airspeed"]
        if strip.kind is FlightKind.TEST:
            departures.append(region.outside(strip.manoeuvre, "recorded", strip.time, recorded))
        departures.append(region.outside(strip.manoeuvre, "simulated", strip.time, simulated))
    return tuple(departure for departure in departures if departure is not None), region


def limits_of(card: Card, bands: Mapping[str, float], region: Region) -> list[str]:
    limits, names = [], [n for n, t in card.tolerances.items() if n not in bands and t != TOLERANCES.get(n)]
    if names:
        limits.append(f"The tolerance of {several(names)} is not judged: not recorded, or not an output of the model.")
    if "alpha" in region.channels:
        alpha = np.degrees(region.points[:, region.channels.index("alpha")].max())
        limits.append(f"The largest angle of attack is {alpha:.1f} deg; Attachment 7 asks for 10 deg beyond the stall.")
    return limits


# --- qualification.json.

RESULTS = "qualification.json"


def qualification_results(
    qualification: Qualification, card: Card, source: dict[str, Any], failures: Sequence[str] = ()
) -> QualificationDocument:
    tests = []
    for test in qualification.tests:
        chance = {"probability": test.chance.value, "standard_error": test.chance.error, "verdict": test.chance.verdict}
        tests.append(TestPart.of(test, **chance))
    return QualificationDocument.of(
        qualification,
        card=card,
        verdict=qualification.whole,
        thresholds={"passes_from": PASSES_FROM, "fails_to": FAILS_TO},
        tolerances={
            name: JudgedTolerance.of((value, STANDARD_CHANNELS[name].unit, text, qualification.verdict(name)))
            for name, (value, text) in qualification.tolerances.items()
        },
        tests=tests,
        flown_region={"channels": qualification.channels, "not_recorded": qualification.unjudged},
        consistency=ConsistencyPart.of(qualification.consistency),
        failures=failures,
        provenance=source,
    )


# --- What is not known of a finished model: draws of its parameters, its next flight, hold-out errors, gusts.

LENGTH = 533.0  # m, of a gust whose intensity alone is stated: MIL-F-8785C, above 610 m
GUSTS = ("vertical_gust", "longitudinal_gust", "lateral_gust")
NEXT_FLIGHT = "next_flight.nc"


def uncertain(
    source: FinishedResult, flown: SegmentTrajectories, options: QualifyOptions, progress: Progress = quiet
) -> tuple[Uncertain, dict[str, str]]:
    """What is not known of the model, and a sentence on where each part comes from; `flown`: its records."""
    names, count = flown.dynamics.names, options.draws
    estimate = np.array([source.identified.values[name] for name in names])
    if source.command == "diagnose":
        fit = fit_output_error(flown, start=estimate, max_iterations=0)
        inflation = trajectory_variance_inflation(fit)
        values = posterior_draws(fit, inflation, options.seed, count)
        origin = f"Normal distribution about the estimates, by the trajectories (variances times {inflation:.3g})."
    else:  # what the result does not determine stays at its estimate
        draws = drawn(source, names, count, options.seed)
        values = np.tile(estimate, (count, 1))
        values[:, [names.index(name) for name in draws.names]] = draws.values
        origin = f"{draws.origin[0].upper()}{draws.origin[1:]}."
    if source.command == "fly" and not source.filtered:  # output error gave the values
        model = Uncertain(estimate, values, fitted=True)
        model, more = between_manoeuvres(source, model, flown, options.seed, progress)
    else:
        following = drawn_by_identify(source, names, estimate, count, options.seed)
        model = Uncertain(estimate, values, fitted=False, following=following)
        more = {
            "structure": "The errors of the simulated records, less what the parameters explain: the parameters were "
            "not fitted to these trajectories.",
            "next flight": "Not counted by itself: the result has no scatter between manoeuvres (identify "
            "--next-flight has). The errors of the records hold it."
            if following is None
            else f"Partial pooling of the manoeuvres by identify ({NEXT_FLIGHT}).",
        }
    gusts, stated, about_gusts = gusts_of(source, options.gusts)
    return replace(model, gusts=gusts, met=not stated), {"parameters": origin, **more, "gusts": about_gusts}


def between_manoeuvres(
    source: FinishedResult, model: Uncertain, flown: SegmentTrajectories, seed: int, progress: Progress
) -> tuple[Uncertain, dict[str, str]]:
    """Hold-out errors and the scatter between manoeuvres, where there are at least two."""
    count, linear = len(flown.index), source.linear
    separate, flat = (linear.rows.by_manoeuvre, linear.fitted.flat) if linear is not None else ((), ())
    alone = "The errors of the fitted records, which are smaller than those of a flight that was not fitted"
    if not 1 < count <= MAX_SEPARATE_FITS or separate:
        why = f"{alone}: with {count} manoeuvre{'s' * (count > 1)} none was left out."
        needs = f"Not counted: it needs 2 to {MAX_SEPARATE_FITS} manoeuvres."
        if separate:
            states = f"the card states {several(separate)} for each manoeuvre"
            why, needs = f"{alone}: {states}, so that a flight that is not fitted has none.", f"Not counted: {states}."
        return model, {"structure": why, "next flight": needs}
    progress("fits without each manoeuvre", 0.0)
    inflation = float(source.told["variance_inflation"])
    outputs = tuple(source.told["fitted_outputs"])
    again = replace(flown, outputs=outputs, noise_growth=np.ones((*flown.index.shape, len(outputs))))
    fit = fit_output_error(again, start=model.estimate, prior_weight=inflation)
    without = fits_without(fit, FlightNoise(inflation, FlightNoise.of(fit).parts))
    held = hold_out(flown, without, inflation, seed)
    following, why_not = None, "Not counted: fewer than two manoeuvres have a usable fit of their own."
    if flat:
        why_not = f"Not counted by itself: the card states no prior of {several(flat)}, in units of which it is sought."
    else:
        progress("scatter between manoeuvres", 0.5)
        following = next_parameters(alone_fits(fit, without, inflation), inflation, len(model.draws), seed, progress)
    origins = {
        "structure": "A manoeuvre flown again: the errors of the fitted records. Other flights: the errors of every "
        "manoeuvre by the fit to the others, less what parameters explain."
        if held is not None
        else f"{alone}; a fit without one manoeuvre cannot fly it.",
        "next flight": f"Partial pooling of the fits to each of the {count} manoeuvres by trajectories."
        if following is not None
        else why_not,
    }
    return replace(model, hold_out=held, following=following), origins


def drawn_by_identify(
    source: FinishedResult, names: Sequence[str], estimate: Float[np.ndarray, " k"], count: int, seed: int
) -> Float[np.ndarray, "m k"] | None:
    file = source.folder / NEXT_FLIGHT
    if source.command != "identify" or not file.is_file():
        return None
    with xr.open_datatree(file, engine="h5netcdf") as tree:
        following = tree["posterior"].to_dataset()["next_flight"]
        order, draws = following["parameter"].values.astype(str), np.asarray(following).reshape(-1, following.shape[-1])
    kept = np.random.default_rng([seed, 11]).choice(len(draws), count, replace=len(draws) < count)
    values = np.tile(estimate, (count, 1))
    for column, name in enumerate(order):
        values[:, list(names).index(name)] = np.clip(draws[kept, column], *source.identified.bounds[name])
    return values


def gusts_of(source: FinishedResult, stated: float | None) -> tuple[dict[str, float], bool, str]:
    """Intensities and lengths, whether they were stated, and a sentence on them."""
    if stated == 0.0:
        return {}, True, "Not counted: calm air was stated."
    if stated is not None:
        gusts = dict.fromkeys(GUSTS, stated) | {f"{name}_length": LENGTH for name in GUSTS}
        return gusts, True, f"Stated: {stated:g} m/s in every direction, scale length {LENGTH:.0f} m."
    if source.linear is not None:
        return {}, True, "Not counted: a linear system does not fly through moving air."
    results = source.told
    if source.filtered:
        keys = {key for name in GUSTS for key in (name, f"{name}_length")}
        met = {name: float(x) for name, (x, _) in results["process_noise"]["gusts"].items() if name in keys}
        strong = [f"{name} {met[name]:.2g} m/s" for name in GUSTS if met.get(name, 0.0) > 1e-3]
        if strong:
            return met, False, f"As the fit with process noise found them in the records: {', '.join(strong)}."
    return {}, True, "Not counted: the result has no gusts; --gusts states an intensity."
