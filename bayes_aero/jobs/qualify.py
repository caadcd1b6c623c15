"""The job of `bayes-aero qualify`: how probably a finished model passes its tolerances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from jaxtyping import Float

from bayes_aero.diagnosis.trajectories.histories import posterior_draws
from bayes_aero.diagnosis.trajectories.holdout import Noise, trajectory_variance_inflation
from bayes_aero.dynamics.flight import Dynamics, aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health.same_record import repeats_of
from bayes_aero.flight.reading.read_record import read_records
from bayes_aero.flight.record import TOLERANCES, FlightRecord
from bayes_aero.inference.likelihood.mle import MAX_SEPARATE_FITS
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.jobs.fitted import (
    MOST_DRAWS,
    Finished,
    IdentifiedLinear,
    card_of,
    drawn,
    fitted_records,
    read_finished,
    with_process_noise,
)
from bayes_aero.jobs.io.consistency_json import consistency_results, health_results
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.io.result_file import result_file
from bayes_aero.jobs.provenance import provenance, write_json
from bayes_aero.jobs.steps.record_checks import record_checks
from bayes_aero.model.joined_channels import Flights, despiked, join
from bayes_aero.progress import Progress
from bayes_aero.qualification.flights import (
    OpenTest,
    alone_fits,
    fits_without,
    further_flights,
    hold_out,
    next_parameters,
)
from bayes_aero.qualification.qualify import CHANNELS, Region, Uncertain, qualify
from bayes_aero.qualification.result import (
    FAILS_TO,
    PASSES_FROM,
    FlightKind,
    Further,
    Outside,
    Qualification,
    Strip,
    Test,
)
from bayes_aero.report.html.page import put_page
from bayes_aero.report.qualification import QualificationContext, qualification_page, test_table
from bayes_aero.report.tables.table import write_csv
from bayes_aero.report.text.phrases import several

DRAWS = 400
FEWEST = 100  # draws: with fewer no probability is decided
MOST_GUSTS = 20.0  # m/s
UNSCATTERED = (
    "The errors of every manoeuvre by the fit to the others, which hold the scatter between manoeuvres. The scatter of "
    "their own fits is not used: it would make flights differ by more than those left out did, so it is mostly its "
    "prior."
)


@dataclass(frozen=True)
class QualifyOptions:
    """What a qualification may be told.

    `card`: of the result, where it is not found by itself; `fitted`: files of its records, likewise. `draws` of every
    flight. `gusts`: a stated intensity, m/s.
    """

    card: str | None = None
    fitted: tuple[Path, ...] = ()
    draws: int = DRAWS
    seed: int = 0
    gusts: float | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that decide nothing."""
        if not FEWEST <= self.draws <= MOST_DRAWS:
            raise InputError(f"--draws is {self.draws}; give a number from {FEWEST} to {MOST_DRAWS}")
        if self.gusts is not None and not 0.0 <= self.gusts <= MOST_GUSTS:
            raise InputError(f"--gusts is {self.gusts:g} m/s; give a number from 0 to {MOST_GUSTS:g}")


def qualify_result(
    given: str,
    tests: Sequence[Path] = (),
    options: QualifyOptions = QualifyOptions(),
    *,
    out: Path | None = None,
    progress: Progress | None = None,
) -> tuple[Qualification, tuple[str, ...]]:
    """Qualify the model of a finished result of identify, fly or diagnose.

    Args:
        given: folder or file of the result.
        tests: records that were not fitted, as further tests.
        options: the settings.
        out: folder for qualification.json, qualification.csv and qualification.html.
        progress: called with a stage and the share of it that is done.

    Returns:
        The qualification, and a sentence on each part that could not be made.

    Raises:
        InputError: there is no result, no tolerance, or a record is missing or cannot be flown.
    """
    file = result_file(given)
    if file is None:
        raise InputError(f"{given} is a card, and a card has no uncertainty; give the folder of a result")
    found, folder, told = read_finished(str(file), options.card)
    assert folder is not None
    card = card_of(told["provenance"], file, options.card)
    records = fitted_records(told["provenance"], file, card, remedy="give it with --fitted", files=options.fitted)
    new = _new_records(tests, records, card)
    source = Source(found, folder, told)
    _flyable(source, new, options.gusts)
    if out is not None:
        writable(out)
    if progress:
        progress("do the sensors agree?", 0.0)
    checks = record_checks([*records, *new], card, options.seed, out)
    with checks.behind():
        flown, bands = _segments(source, card, records)
        tested, _ = _segments(source, card, new, tuple(bands)) if new else (None, {})
        unknown, origins = uncertain(source, flown, options.draws, options.seed, options.gusts, progress)
        results = qualify(flown, tested, unknown, bands, seed=options.seed, progress=progress)
    further = _further(source, card, flown, results.undecided, unknown)
    outside, region = _outside(flown, tested, results.strips)
    qualification = Qualification(
        tests=results.tests,
        outside=outside,
        channels=region.channels,
        unjudged=tuple(n for n in CHANNELS if n not in region.channels and n != "mach"),
        strips=results.strips,
        tolerances={name: (x, card.tolerances[name].source) for name, x in bands.items()},
        draws=options.draws,
        origins=origins
        if results.scattered in (None, True) or unknown.following is None
        else origins | {"next flight": UNSCATTERED},
        notes=(*found.sources, *_unjudged(card, bands), *_reach(region)),
        further=further,
        health=checks.health,
        consistency=checks.consistency,
    )
    if out is None:
        return qualification, checks.failures
    settings: dict[str, object] = {"result": file.name, "draws": options.draws, "gusts": options.gusts}
    source = provenance(card, [*records, *new], options.seed, settings, options)
    return qualification, _put(qualification, card, source, checks.failures, out)


def _new_records(tests: Sequence[Path], fitted: Sequence[FlightRecord], card: Card) -> list[FlightRecord]:
    """Records that were not fitted, read as those were; refused where they repeat samples of one that was."""
    how = fitted[0].read
    new = read_records(tests, card.channels, resample=how["resample"], segments=card.segments, split=how["split"])
    for record in new:
        for one in fitted:
            if (shared := repeats_of(one, record)) is not None:
                raise InputError(
                    f"{record.name} {shared[0]}; {one.name} was fitted, so it is tested anyway: give records that were "
                    "not fitted"
                )
    return new


def _flyable(source: Source, new: Sequence[FlightRecord], gusts: float | None) -> None:
    """Refuse what a linear system cannot fly."""
    if source.linear is None:
        return
    if gusts:
        raise InputError(
            f"card {source.found.name} states a linear system, which does not fly through moving air; leave --gusts out"
        )
    if new and (own := source.linear.rows.by_manoeuvre):
        raise InputError(
            f"card {source.found.name} states {several(own)} for each manoeuvre, so there is no value for record "
            f"{new[0].name}, which was not fitted; leave it out, or fit a card with one value for all manoeuvres"
        )


def _further(
    source: Source, card: Card, flown: SegmentTrajectories, undecided: Sequence[OpenTest], unknown: Uncertain
) -> Further | None:
    """Flights that would decide the undecided tests."""
    if not undecided:
        return None
    if isinstance(source.found, IdentifiedLinear):
        return Further((), why_not="a linear system does not know the forces and moments of other manoeuvres")
    flights, names = flown.flights, list(flown.dynamics.names)
    assert isinstance(flights, Flights)
    values = {name: float(source.found.values[name]) for name in source.found.model.names}
    errors = unknown.draws - unknown.estimate
    try:
        return further_flights(undecided, names, errors, flights, source.found.model, values, card.envelope)
    except InputError as error:
        return Further((), why_not=str(error))


def _segments(
    source: Source, card: Card, records: Sequence[FlightRecord], outputs: tuple[str, ...] = ()
) -> tuple[SegmentTrajectories, dict[str, float]]:
    """Whole manoeuvres with the outputs that have a tolerance, and half the widths of their bands, SI."""
    found = source.found
    if isinstance(found, IdentifiedLinear):
        flights, _ = despiked(join(records, card, found.rows.inputs))
        dynamics: Dynamics = found.dynamics(flights)
    else:
        flights, _ = despiked(join(records, card, FLIGHT))
        dynamics = aircraft_dynamics(found.model, flights)
    theta = np.array([found.values[name] for name in dynamics.names])
    there = [n for n in dynamics.outputs if n in flights.channels]
    bands = {n: card.tolerances[n].value for n in there if n in card.tolerances}
    for name in outputs:
        if name not in bands:
            raise InputError(
                f"record {records[0].name} has no channel {name}, which has a tolerance; leave the record out"
            )
    if not bands:
        raise InputError(
            f"card {card.name} has no tolerance of an output that was recorded and simulated ({', '.join(there)}); "
            "state one under [tolerances]"
        )
    chosen = outputs or tuple(bands)
    return segments(flights, dynamics, outputs=chosen, substeps=dynamics.substeps(theta, flights)), bands


def _outside(
    flown: SegmentTrajectories, tested: SegmentTrajectories | None, strips: Sequence[Strip]
) -> tuple[tuple[Outside, ...], Region]:
    """Where recorded and simulated motions leave the flown region; it has no channels where none was recorded."""
    every = [flown.flights.channels] + ([] if tested is None else [tested.flights.channels])
    shared = set.intersection(*(set(one) for one in every))
    region = Region.of({n: np.asarray(x) for n, x in flown.flights.channels.items() if n in shared})
    found = []
    for strip in strips:
        if strip.kind is FlightKind.NEXT or not region.channels:
            continue
        source = tested if strip.kind is FlightKind.TEST and tested is not None else flown
        own = source.flights.manoeuvre == source.flights.names.index(strip.manoeuvre)
        recorded = {n: np.asarray(x)[own] for n, x in source.flights.channels.items() if n in region.channels}
        if strip.kind is FlightKind.TEST:
            found.append(region.outside(strip.manoeuvre, "recorded", strip.time, recorded))
        found.append(region.outside(strip.manoeuvre, "simulated", strip.time, recorded | _simulated(strip, recorded)))
    return tuple(one for one in found if one is not None), region


def _simulated(strip: Strip, recorded: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The simulated channels of a region; the Mach number goes with the airspeed."""
    found = {n: x for n, x in strip.simulated.items() if n in recorded}
    if "mach" in recorded and "airspeed" in strip.simulated:
        found["mach"] = recorded["mach"] * strip.simulated["airspeed"] / strip.measured["airspeed"]
    return found


def _unjudged(card: Card, bands: Mapping[str, float]) -> tuple[str, ...]:
    """The tolerances that the card states and the model cannot be asked for."""
    names = [n for n, t in card.tolerances.items() if n not in bands and t != TOLERANCES.get(n)]
    if not names:
        return ()
    return (f"The tolerance of {several(names)} is not judged: not recorded, or not an output of the model.",)


def _reach(region: Region) -> tuple[str, ...]:
    """The largest flown angle of attack, which the rule on stall training asks for."""
    if "alpha" not in region.channels:
        return ()
    alpha = np.degrees(region.points[:, region.channels.index("alpha")].max())
    return (
        f"The largest recorded angle of attack is {alpha:.1f} deg. Attachment 7 asks for a valid model up to 10 deg "
        "beyond the stall identification angle of attack, which the program does not know.",
    )


def _put(
    found: Qualification, card: Card, source: dict[str, Any], failures: tuple[str, ...], out: Path
) -> tuple[str, ...]:
    """Numbers first, then the page; what could not be made."""
    write_csv(test_table(found), out / "qualification.csv")
    write_json(qualification_results(found, card, source, failures), out / RESULTS)
    context = QualificationContext(card, source)
    unmade = put_page(lambda: qualification_page(found, context), out, "qualification.html")
    if unmade:
        write_json(qualification_results(found, card, source, (*failures, *unmade)), out / RESULTS)
    return (*failures, *unmade)


# --- qualification.json.

SCHEMA = "bayes_aero/qualification/2"
RESULTS = "qualification.json"


def qualification_results(
    found: Qualification, card: Card, source: dict[str, Any], failures: Sequence[str] = ()
) -> dict[str, Any]:
    """Plain numbers and text, SI and radians (schemas/qualification.schema.json)."""
    return {
        "schema": SCHEMA,
        "card": {"name": card.name, "title": card.title},
        "verdict": found.whole.value,
        "thresholds": {"passes_from": PASSES_FROM, "fails_to": FAILS_TO},
        "draws": found.draws,
        "tolerances": {
            name: {
                "value": value,
                "unit": STANDARD_CHANNELS[name].unit,
                "source": text,
                "verdict": found.verdict(name).value,
            }
            for name, (value, text) in found.tolerances.items()
        },
        "tests": [_test(one) for one in found.tests],
        "flown_region": {"channels": list(found.channels), "not_recorded": list(found.unjudged)},
        "outside": [asdict(one) for one in found.outside],
        "further": None if found.further is None else _further_flights(found.further),
        "origins": dict(found.origins),
        "health": health_results(found.health),
        "consistency": {} if found.consistency is None else consistency_results(found.consistency),
        "notes": list(found.notes),
        "failures": list(failures),
        "provenance": source,
    }


def _further_flights(found: Further) -> dict[str, Any]:
    points = [asdict(p) for p in found.points]
    return {
        "tests": [asdict(t) | {"kind": t.kind.value} for t in found.tests],
        "points": [{**p, "probabilities": p.pop("expected"), "nats_per_second": p.pop("rate")} for p in points],
        "refused": dict(found.refused),
        "why_not": found.why_not,
    }


def _test(one: Test) -> dict[str, Any]:
    beside = one.recorded
    return {
        "kind": one.kind.value,
        "manoeuvre": one.manoeuvre,
        "output": one.output,
        "tolerance": one.tolerance,
        "probability": one.chance.value,
        "standard_error": one.chance.error,
        "counted": {name: asdict(chance) for name, chance in one.chances.items()},
        "verdict": one.chance.verdict.value,
        "within": one.within,
        "record": None if beside is None else asdict(beside) | {"passed": beside.passed},
    }


# --- What is not known of a finished model: draws of its parameters, its next flight, hold-out errors, gusts.

LENGTH = 533.0  # m, of a gust whose intensity alone is stated: MIL-F-8785C, above 610 m
GUSTS = ("vertical_gust", "longitudinal_gust", "lateral_gust")
NEXT_FLIGHT = "next_flight.nc"


@dataclass(frozen=True)
class Source:
    """A finished result: the model, its folder, what it says."""

    found: Finished
    folder: Path
    told: Mapping[str, Any]

    @property
    def linear(self) -> IdentifiedLinear | None:
        """The model, where it is a linear system."""
        return self.found if isinstance(self.found, IdentifiedLinear) else None

    @property
    def by_trajectories(self) -> bool:
        """Whether output error gave the values."""
        return "fitted_outputs" in self.told and "mle" not in self.told and not with_process_noise(self.told)


def uncertain(
    source: Source,
    flown: SegmentTrajectories,
    draws: int,
    seed: int,
    gusts: float | None,
    progress: Progress | None = None,
) -> tuple[Uncertain, dict[str, str]]:
    """What is not known of the model, and a sentence on where each part comes from.

    Args:
        source: the result.
        flown: its records, with the outputs that have a band.
        draws: how many.
        seed: of all draws.
        gusts: a stated intensity, m/s; None: what the result has estimated.
        progress: called with a stage and the share of it that is done.
    """
    names = flown.dynamics.names
    estimate = np.array([source.found.values[name] for name in names])
    values, said = _draws(source, flown, estimate, draws, seed)
    model = Uncertain(estimate, values, fitted=source.by_trajectories)
    origins = {"parameters": said}
    if source.by_trajectories:
        model, more = _refitted(source, model, flown, seed, progress)
        origins |= more
    else:
        origins["structure"] = (
            "The errors of the simulated records, less what the parameters explain: the parameters were not fitted to "
            "these trajectories."
        )
        following = _of_identify(source, names, estimate, draws, seed)
        model = replace(model, following=following)
        origins["next flight"] = (
            f"Partial pooling of the manoeuvres by identify ({NEXT_FLIGHT})."
            if following is not None
            else "Not counted by itself: the result has no scatter between manoeuvres (identify --next-flight has). "
            "The errors of the records hold it."
        )
    found, stated, said = _gusts(source, gusts)
    return replace(model, gusts=found, met=not stated), origins | {"gusts": said}


def _draws(
    source: Source, flown: SegmentTrajectories, estimate: Float[np.ndarray, " k"], count: int, seed: int
) -> tuple[Float[np.ndarray, "m k"], str]:
    """Of the parameters; those that the result does not determine stay at their estimate."""
    names = flown.dynamics.names
    if "causes" in source.told:
        fit = fit_output_error(flown, start=estimate, max_iterations=0)
        inflation = trajectory_variance_inflation(fit)
        return posterior_draws(fit, inflation, seed, count), (
            "Normal distribution about the estimates; the covariance is that of the trajectories at these values, for "
            f"coloured residuals (variances times {inflation:.3g})."
        )
    found = drawn(source.found, source.folder, source.told, names, count, seed)
    values = np.tile(estimate, (count, 1))
    for column, name in enumerate(found.names):
        values[:, names.index(name)] = found.values[:, column]
    return values, f"{found.origin[0].upper()}{found.origin[1:]}."


def _refitted(
    source: Source, model: Uncertain, flown: SegmentTrajectories, seed: int, progress: Progress | None
) -> tuple[Uncertain, dict[str, str]]:
    """Hold-out errors and the scatter between manoeuvres, where there are at least two."""
    count = len(flown.index)
    own = source.linear.rows.by_manoeuvre if source.linear is not None else ()
    alone = "The errors of the fitted records, which are smaller than those of a flight that was not fitted"
    if not 1 < count <= MAX_SEPARATE_FITS:
        return model, {
            "structure": f"{alone}: with {count} manoeuvre{'s' if count > 1 else ''} none was left out.",
            "next flight": f"Not counted: it needs 2 to {MAX_SEPARATE_FITS} manoeuvres.",
        }
    if own:
        return model, {
            "structure": f"{alone}: a flight that is not fitted has no value of {several(own)}, which the card states "
            "for each manoeuvre.",
            "next flight": f"Not counted: the card states {several(own)} for each manoeuvre.",
        }
    if progress:
        progress("fits without each manoeuvre", 0.0)
    inflation = float(source.told["variance_inflation"])
    outputs = tuple(source.told["fitted_outputs"])
    steady = np.ones((*flown.index.shape, len(outputs)))
    again = replace(flown, outputs=outputs, noise_growth=steady)
    fit = fit_output_error(again, start=model.estimate, prior_weight=inflation)
    noise = Noise(inflation, Noise.of(fit).parts)
    without = fits_without(fit, noise)
    held = hold_out(flown, without, inflation, seed)
    flat = source.linear.fitted.flat if source.linear is not None else ()
    following, said = None, ""
    if flat:
        said = (
            f"Not counted by itself: the card states no prior of {several(flat)}, and the scatter between manoeuvres "
        )
        said += "is sought in units of the priors. The errors of manoeuvres left out hold it."
    else:
        if progress:
            progress("scatter between manoeuvres", 0.5)
        following = next_parameters(alone_fits(fit, without, inflation), inflation, len(model.draws), seed, progress)
    origins = {
        "structure": "A manoeuvre flown again: the errors of the fitted records. Other flights: the errors of every "
        "manoeuvre by the fit to the others, less what parameters explain."
        if held is not None
        else f"{alone}; a fit without one manoeuvre cannot fly it.",
        "next flight": f"Partial pooling of the fits to each of the {count} manoeuvres by trajectories."
        if following is not None
        else said or "Not counted: fewer than two manoeuvres have a usable fit of their own.",
    }
    return replace(model, hold_out=held, following=following), origins


def _of_identify(
    source: Source, names: Sequence[str], estimate: Float[np.ndarray, " k"], count: int, seed: int
) -> Float[np.ndarray, "m k"] | None:
    """The next flight's parameters that identify has drawn, where it was asked to."""
    file = source.folder / NEXT_FLIGHT
    if "mle" not in source.told or not file.is_file():
        return None
    with xr.open_datatree(file, engine="h5netcdf") as tree:
        one = tree["posterior"].to_dataset()["next_flight"]
        known, drawn = [str(n) for n in one["parameter"].values], np.asarray(one).reshape(-1, one.shape[-1])
    kept = np.random.default_rng([seed, 11]).choice(len(drawn), count, replace=len(drawn) < count)
    bounds = source.found.bounds
    values = np.tile(estimate, (count, 1))
    for column, name in enumerate(known):
        values[:, list(names).index(name)] = np.clip(drawn[kept, column], *bounds[name])
    return values


def _gusts(source: Source, stated: float | None) -> tuple[dict[str, float], bool, str]:
    """Intensities and lengths, whether they were stated, and a sentence on them."""
    if stated == 0.0:
        return {}, True, "Not counted: calm air was stated."
    if stated is not None:
        found = dict.fromkeys(GUSTS, stated) | {f"{name}_length": LENGTH for name in GUSTS}
        return found, True, f"Stated: {stated:g} m/s in every direction, scale length {LENGTH:.0f} m."
    if source.linear is not None:
        return {}, True, "Not counted: a linear system does not fly through moving air."
    told = source.told
    if with_process_noise(told):
        met = {name: float(x) for name, (x, _) in told["process_noise"]["gusts"].items() if name.startswith(GUSTS)}
        strong = [f"{name} {met[name]:.2g} m/s" for name in GUSTS if met.get(name, 0.0) > 1e-3]
        if strong:
            return met, False, f"As the fit with process noise found them in the records: {', '.join(strong)}."
    return {}, True, "Not counted: the result has no gusts; --gusts states an intensity."
