"""The job of `bayes-aero qualify`: how probably a finished model passes its tolerances."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_aero.dynamics.flight import Dynamics, aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import SegmentTrajectories, segments
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health.same_record import repeats_of
from bayes_aero.flight.reading.read_record import read_records
from bayes_aero.flight.record import FlightRecord
from bayes_aero.flight.tolerances import TOLERANCES
from bayes_aero.jobs.handover.fitted_records import fitted_records
from bayes_aero.jobs.handover.identified_card import card_of
from bayes_aero.jobs.handover.identified_linear import IdentifiedLinear
from bayes_aero.jobs.handover.identified_result import read_finished
from bayes_aero.jobs.handover.posterior_draws import MOST_DRAWS
from bayes_aero.jobs.handover.qualification_json import RESULTS, qualification_results
from bayes_aero.jobs.handover.result_file import result_file
from bayes_aero.jobs.handover.uncertain_model import Source, uncertain
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.provenance.provenance import provenance, write_json
from bayes_aero.jobs.steps.record_checks import record_checks
from bayes_aero.model.joined_channels import Flights, despiked, join
from bayes_aero.progress import Progress
from bayes_aero.qualification.further_flights import OpenTest, further_flights
from bayes_aero.qualification.qualify import Uncertain, qualify
from bayes_aero.qualification.region import CHANNELS, Region
from bayes_aero.qualification.result import Further, Kind, Outside, Qualification, Strip
from bayes_aero.report.html.page import put_page
from bayes_aero.report.qualification.page import QualificationContext, qualification_page
from bayes_aero.report.qualification.tables import test_table
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
        if strip.kind is Kind.NEXT or not region.channels:
            continue
        source = tested if strip.kind is Kind.TEST and tested is not None else flown
        own = source.flights.manoeuvre == source.flights.names.index(strip.manoeuvre)
        recorded = {n: np.asarray(x)[own] for n, x in source.flights.channels.items() if n in region.channels}
        if strip.kind is Kind.TEST:
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
