"""What each command has found, as its document and its time histories."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import UNSET

from bayes_aero.atomic_write import write_whole
from bayes_aero.diagnosis import result
from bayes_aero.errors import failure, plain_line
from bayes_aero.flight.card import Card
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.health import Consistency, HealthFinding
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.results import (
    FrequencyFit,
    GPReport,
    Identification,
    Inseparable,
    MleResult,
    NextFlight,
    Posterior,
)
from bayes_aero.jobs import documents as parts
from bayes_aero.jobs.options import FIXED, FREE, HELD, LINEAR
from bayes_aero.jobs.store import picked
from bayes_aero.model.records import with_sums
from bayes_aero.physics.filters import differentiate, smooth
from bayes_aero.report.pages.diagnosis import sentences
from bayes_aero.report.pages.estimates import flown
from bayes_aero.report.pages.fly import parameter_rows
from bayes_aero.report.pages.identification import next_flight_table, parameter_table, validation_table
from bayes_aero.report.table import write_csv

if TYPE_CHECKING:  # pandas takes half a second to load, and is needed when a run ends
    import xarray as xr

FLOWN = (0.001, 0.999)  # quantiles that bound the flown range of a channel
UNITS = {name: channel.unit for name, channel in STANDARD_CHANNELS.items()}

Hidden = Mapping[str, Mapping[str, float]]  # true values of what simulated records hide, by effect


@dataclass(frozen=True)
class Outcome:
    view: result.DiagnosisView
    hidden: Hidden | None = None
    named: Mapping[str, str] = field(default_factory=dict)  # each hidden effect: first, named, ambiguous, minor, missed
    notes: tuple[str, ...] = ()
    health: tuple[HealthFinding, ...] = ()
    consistency: Consistency | None = None
    failures: tuple[str, ...] = ()  # parts that failed unexpectedly
    test_points: Mapping[str, Any] = field(default_factory=dict)  # the manoeuvres that decide all that is open
    in_band: result.CausesInBand | None = None  # sizes of the causes in a band of frequencies

    @property
    def diagnosis(self) -> result.Diagnosis:
        return self.view.diagnosis


def diagnosis_results(
    outcome: Outcome, card: Card, records: Sequence[FlightRecord], provenance: Mapping[str, Any]
) -> parts.DiagnosisDocument:
    """Everything found, as plain numbers and text; `hidden` is the truth where the records are simulated."""
    view, d = outcome.view, outcome.diagnosis
    seen = view if isinstance(view, result.View) else None  # coefficients; else only trajectories were compared
    named = {(c.stage, c.name) for c in d.causes}
    models = {} if seen is None else {"before": seen.card, "after": seen.extended}
    return parts.DiagnosisDocument.of(
        d,
        card=card,
        records=record_parts(records, card),
        consistency=parts.ConsistencyPart.of(outcome.consistency),
        tested=part_of_errors(d.tested, d.compared),
        sentences=sentences(d, view.trajectories),
        causes=[cause_part(cause) for cause in d.causes],
        unexplained=d.unknown,
        terms=[term_part(term) for term in d.terms],
        cancelling=d.together,
        screening=[
            parts.ScreenedPart.of(s, stage=r.stage, threshold=r.threshold, cause=(r.stage, s.effect) in named)
            for r in view.rankings
            for s in r.candidate_scores
        ],  # every candidate in the first election of each stage, the highest score first
        base_parameters=view.moves,
        covariance=view.covariance and parts.CovariancePart.of((*view.covariance, "coloured")),
        residuals={when: model.composition for when, model in models.items()},
        trajectories=trajectories_part(view.trajectories, card),
        stall={} if seen is None else {name: stall.numbers() for name, stall in seen.stalls.items()},
        notes=(*d.notes, *outcome.notes),
        **picked(outcome, "test_points", "in_band", "health", "failures"),
        provenance=provenance,
        hidden=UNSET if outcome.hidden is None else parts.HiddenPart.of((outcome.hidden, outcome.named)),
    )


def term_part(sized: result.FoundTerm) -> parts.TermPart:
    term, others = sized.term, {term.name: weight for term, weight in sized.others}
    return parts.TermPart.of(sized, term=term.name, code=term.code, unit=term.unit, ambiguous_with=others)


def part_of_errors(tested: result.Tested | None, compared: str) -> parts.TestedPart:
    """What a diagnosis by trajectories alone has tested; of one by coefficients, that it sought structure, too."""
    if tested is None:
        return parts.TestedPart.of((compared, compared == result.COEFFICIENTS, None, {}))
    outputs = {n: parts.TestedOutput.of(output, unit=UNITS[n]) for n, output in tested.outputs.items()}
    return parts.TestedPart("trajectories", False, tested.within_noise if outputs else None, outputs)


def record_parts(records: Sequence[FlightRecord], card: Card) -> list[parts.RecordPart]:
    """The records at a glance, with the flown range of each channel (SI), a spike left out."""
    rows = []
    for r in records:
        channels = {name: np.asarray(x, dtype=float) for name, x in with_sums(r, card).items()}
        if "alpha" in channels and "alpha_dot" not in channels:  # its rate, which effects read
            channels["alpha_dot"] = np.asarray(differentiate(smooth(channels["alpha"]), r.dt))
        ranges = {name: tuple(map(float, np.quantile(x, FLOWN))) for name, x in channels.items()}
        rows.append(parts.RecordPart.of((r.name, r.n, r.dt, float(np.ptp(r.time)), ranges)))
    return rows


def cause_part(cause: result.Cause) -> parts.CausePart:
    gain, when = cause.gain, {"before": cause.gain.before, "after": cause.gain.after}
    scores = [(key, word, by) for key in ("r2", "rmse", "r", "theil") for word, by in when.items()]
    by_coefficient = {
        name: {f"{key}_{word}": getattr(by[name], key) for key, word, by in scores}
        for name in gain.before
        if name in gain.after
    }
    return parts.CausePart.of(cause, gain=parts.GainPart.of(gain, by_coefficient=by_coefficient))


# --- Simulated trajectories.


def trajectories_part(flown: result.Trajectories | None, card: Card) -> parts.TrajectoriesPart:
    if flown is None:
        return parts.TrajectoriesPart()
    before, after, confirmed = flown.card, flown.extended, flown.asked
    return parts.TrajectoriesPart.of(
        flown,
        status={"card": before.status.name, "extended": after.status.name},
        at_bound={"card": before.at_bound, "extended": after.at_bound},
        causes={name: parts.KeptPart(*missed, name in confirmed.kept) for name, missed in confirmed.missed.items()},
        tolerances=stated_tolerances(card, {name: UNITS[name] for name in flown.outputs}),
        paths=[path_part(parts.ComparedPath, path) for path in flown.paths],
        parameters={
            name: parts.FlownEstimate(
                before.values.get(name),
                value,
                flown.deviation[name],
                after.units[name],
                name in after.held,
                name in after.at_bound,
            )
            for name, value in after.values.items()
        },
    )


def stated_tolerances(card: Card, units: Mapping[str, str]) -> dict[str, parts.StatedTolerance]:
    stated = {name: t for name, t in card.tolerances.items() if name in units}
    return {name: parts.StatedTolerance(t.value, units[name], t.source) for name, t in stated.items()}


def path_part(
    kind: type[parts.ComparedPath | parts.FlownPath],
    path: result.SimulatedManoeuvre,
    units: Mapping[str, str] | None = None,
) -> Any:
    """One simulated manoeuvre; `units` of outputs (SI) for channels that the program does not know by name."""
    part = parts.ComparedOutput if kind is parts.ComparedPath else parts.PathOutput
    outputs = {n: part.of(**vars(e) | vars(e.theil), unit=(units or UNITS)[n]) for n, e in path.errors.items()}
    return kind.of(path, outputs=outputs)


# --- results.json.


def results(
    run: Identification,
    verdict: list[str],
    provenance: dict[str, Any],
    simulated: Sequence[result.SimulatedManoeuvre] = (),
) -> parts.IdentificationDocument:
    """A run as plain numbers and text, parts not yet computed absent; `simulated`: flown with the fitted values."""
    alone = {name: parts.AloneFit.of(fit, **_fit(fit)) for name, fit in run.alone.items()}
    return parts.IdentificationDocument.of(
        card=run.card,
        records=record_parts(run.records, run.card),
        coefficients=run.forming.value,
        mle=parts.FitPart.of(run.mle, **_fit(run.mle), covariance=run.mle.corrected, alone=alone),
        consistency=parts.ConsistencyPart.of(run.consistency) if run.consistency else UNSET,
        frequency=frequency_part(run.frequency) if run.frequency else UNSET,
        posterior=_sampled(parts.IdentifiedPosterior, run.posteriors, noise=run.noise.value),
        next_flight=next_flight_part(run.next_flight) if run.next_flight else UNSET,
        stall=run.stall.numbers() if run.stall else UNSET,
        gpr=processes_part(run.gp) if run.gp else UNSET,
        simulated=[path_part(parts.FlownPath, path) for path in simulated] or UNSET,
        truth=UNSET if run.truth is None else {name: run.truth[name] for name in flown(run)},
        verdict=verdict,
        **picked(run, "health", "notes", "failures"),
        provenance=provenance | {"seconds": {k: round(v, 2) for k, v in run.seconds.items()}},
    )


def _fit(fit: MleResult) -> dict[str, Any]:
    return {
        "status": fit.status.name.lower(),
        "advice": fit.status.value,
        "parameters": _estimates(fit),
        "inseparable": inseparable_parts(fit.inseparable),
        "strong_correlations": [parts.CorrelatedPart([a, b], value) for a, b, value in fit.strong_correlations()],
        "warnings": fit.warnings(),
    }


def _estimates(fit: MleResult | FrequencyFit, apart: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Estimates with their bounds, by how much the bias of sensor noise was moved, and how far they are apart."""
    bias = [None] * len(fit.names) if fit.bias is None else fit.bias
    keys = ("estimate", "crb", "crb_corrected", "noise_bias", "unit")
    columns = zip(fit.estimate, fit.crb, fit.crb_corrected, bias, fit.units, strict=True)
    rows = zip(fit.names, (dict(zip(keys, row, strict=True)) for row in columns), strict=True)
    return {name: parts.BandEstimate.of(**row, difference=(apart or {}).get(name, UNSET)) for name, row in rows}


def frequency_part(fit: FrequencyFit) -> parts.FrequencyPart:
    return parts.FrequencyPart.of(fit, parameters=_estimates(fit, fit.apart))


def inseparable_parts(sets: Sequence[Inseparable]) -> list[parts.InseparablePart]:
    return [parts.InseparablePart(dict(zip(part.names, part.wider, strict=True))) for part in sets]


def _sampled(kind: Any, posteriors: Mapping[str, Posterior], **more: Any) -> Any:
    """Marginals by sampler and parameter, and whether each sampler's draws may be used; absent without posteriors."""
    status = {key: (p.noise, p.status.name.lower(), p.status.value) for key, p in posteriors.items()}
    marginals = {key: p.marginals for key, p in posteriors.items()}
    return kind.of(**more | marginals, status=status) if posteriors else UNSET


def next_flight_part(flight: NextFlight) -> parts.NextFlightPart:
    parameters = {
        p.name: parts.NextParameter.of(
            unit=p.unit,
            aircraft=flight.aircraft[p.name],
            scatter=asdict(flight.scatter[p.name]) | {"over_prior": flight.narrowed[p.name]},
            next_flight=flight.following[p.name],
            pooled={m: flight.pooled[m][p.name] for m in flight.manoeuvres},
            alone={m: flight.alone[m][p.name] for m in flight.manoeuvres if p.name in flight.alone[m]},
            undetermined=flight.undetermined.get(p.name, ()),
        )
        for p in flight.parameters
    }
    status = {"status": flight.status.name.lower(), "advice": flight.status.value}
    return parts.NextFlightPart.of(flight, likelihood=flight.tree.attrs["likelihood"], parameters=parameters, **status)


def processes_part(report: GPReport) -> parts.ProcessesPart:
    """By split and coefficient: scores over the test points of all folds together, and each fold's own."""
    splits: dict[str, Any] = {}
    for split, folds in report.splits.items():
        splits[split] = {}
        for name in folds[0]:
            pooled = report.pooled(split, name)
            inside = {f"coverage{round(100 * level)}": share for level, share in pooled.coverage.items()}
            each = [{"gpr": fold[name].gp_scores, "mle": fold[name].mle_scores} for fold in folds]
            scores = {"k_hat": pooled.k_hat, "status": pooled.status, "mle": pooled.mle_scores, "folds": each}
            splits[split][name] = parts.ProcessPart.of(pooled.gp_scores, **inside, **scores)
    return parts.ProcessesPart.of(sampled_split=report.chosen, **splits)


# --- What an identification writes beside results.json.


def write_identification(run: Identification, out: Path) -> None:
    write_csv(parameter_table(run), out / "parameters.csv")
    if run.next_flight is not None:
        write_csv(next_flight_table(run), out / "next_flight.csv")
    if run.gp is not None:
        write_csv(validation_table(run), out / "validation.csv")


def save_gp(report: GPReport, path: Path) -> None:
    """gpr.nc: a group per coefficient with its hyperparameters' posterior, and the validation of every split."""
    import xarray as xr

    tree = xr.DataTree(name="gpr")
    for name, fit in report.fits.items():
        if fit.posterior is not None:
            tree[name] = fit.posterior.copy()
    for split, folds in report.splits.items():
        for number, fold in enumerate(folds):
            for name, v in fold.items():
                columns = {k: ("test", getattr(v, k)) for k in ("measured", "gp", "gp_low", "gp_high", "mle")}
                tree[f"validation/{split}_{number}/{name}"] = xr.DataTree(
                    xr.Dataset(columns, coords={"index": ("test", v.test)})
                )
    write_whole(tree.to_netcdf(engine="h5netcdf"), path)


# --- A fit to trajectories with its findings, and the file that holds it, trajectories.json.

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

    flown: result.TrajectoryFit
    sentences: tuple[str, ...]
    notes: tuple[str, ...]
    health: tuple[HealthFinding, ...] = ()
    consistency: Consistency | None = None
    failures: tuple[str, ...] = ()
    apart: tuple[result.Disagreement, ...] = ()
    process_noise: result.ProcessNoise | None = None
    posteriors: Mapping[str, Posterior] = field(default_factory=dict)
    motion: result.Motion | None = None


def fly_results(
    flight: Flight, card: Card, records: Sequence[FlightRecord], source: dict[str, Any]
) -> parts.TrajectoriesDocument:
    flown, fit = flight.flown, flight.flown.fit
    setting, beliefs = flown.setting, flown.departure_sd
    of = "process noise" if flight.motion and flight.motion.filtered else "output error"
    modes = [
        parts.ModePart.of(mode, eigenvalue=(mode.eigenvalue.real, mode.eigenvalue.imag), **mode.quantities)
        for mode in (flight.motion.modes if flight.motion else ())
    ]
    return parts.TrajectoriesDocument.of(
        flown,
        card=card,
        records=record_parts(records, card),
        consistency=parts.ConsistencyPart.of(flight.consistency),
        status=fit.status.name.lower(),
        sentences=flight.sentences,
        fitted_outputs=fit.flown.outputs,
        setting=parts.SettingPart(
            FREE if setting.initial is None else FIXED, setting.priors, HELD if setting.held else LINEAR
        ),
        **picked(fit, "iterations", "cost", "det_R"),
        parameters=parameter_rows(flown),
        covariance=fit.corrected,
        inseparable=inseparable_parts(fit.inseparable),
        disagreement=flight.apart,
        process_noise=flight.process_noise or UNSET,
        posterior=_sampled(parts.FlownPosterior, flight.posteriors, **dict.fromkeys(SAMPLERS, UNSET)),
        frequency=[frequency_part(fit) for fit in flown.frequency] or UNSET,
        motion=parts.MotionPart.of(flight.motion, modes=modes, estimates=of) if flight.motion else UNSET,
        initial_states={
            manoeuvre: {n: parts.InitialState(*x, flown.units.get(n, "1"), beliefs.get(n)) for n, x in states.items()}
            for manoeuvre, states in flown.initial.items()
        },
        residual_sd=dict(zip(fit.flown.outputs, np.sqrt(fit.R), strict=True)),
        tolerances=stated_tolerances(card, {name: flown.units[name] for name in flown.outputs}),
        paths=[path_part(parts.FlownPath, path, flown.units) for path in flown.paths],
        **picked(flight, "health", "notes", "failures"),
        provenance=source,
    )


# --- histories.nc: the time histories behind the numbers of a run, to be laid over those of another tool. SI, radians.

HISTORIES = "histories.nc"
ENGINE = "h5netcdf"
Histories = Mapping[str, "xr.Dataset"]
"""Groups of the file by name: manoeuvres end to end, `manoeuvre` the number of each sample's, from 1 as in `names`."""


def diagnosed(view: result.View) -> Histories:
    """Coefficients by both models: measured less what a model leaves, with errors of sensors that it knows; and X."""
    models = {"card": view.card, "extended": view.extended}
    columns = {}
    for c, name in enumerate(view.coefficients):
        columns[f"{name}_measured"] = view.measured[:, c], "1"
        columns |= {f"{name}_{key}": (view.measured[:, c] - m.residual[:, c], "1") for key, m in models.items()}
    columns |= {f"X_{key}": (m.signals["X"], "1") for key, m in models.items() if "X" in m.signals}
    time = view.diagnosis.aerodynamics.state.responses.flights.time
    return {"coefficients": _group(columns, view.names, view.manoeuvre, time)}


def identified(run: Identification) -> Histories:
    o, both = run.observations, {"measured": np.asarray(run.observations.measured), "fitted": run.fitted}
    columns = {f"{n}_{key}": (x[:, c], "1") for c, n in enumerate(o.coefficients) for key, x in both.items()}
    return {"coefficients": _group(columns, o.names, o.manoeuvre, o.time)}


def flights(paths: Iterable[result.SimulatedManoeuvre], units: Mapping[str, str] | None = None) -> Histories:
    """Outputs as measured and by each model, a group for each split; `units` (SI) of channels that are not standard."""
    si_units = units or UNITS
    splits: dict[str, dict[str, dict[str, result.SimulatedManoeuvre]]] = {}
    for path in paths:
        splits.setdefault(path.split, {}).setdefault(path.manoeuvre, {})[path.model] = path
    groups = {}
    for split, named in splits.items():
        firsts = [next(iter(models.values())) for models in named.values()]
        columns: dict[str, tuple[np.ndarray, str]] = {}
        for n in firsts[0].measured:
            columns[column(n, "measured")] = np.concatenate([p.measured[n] for p in firsts]), si_units[n]
            for model in next(iter(named.values())):
                simulated = [models[model].simulated[n] for models in named.values()]
                columns[column(n, model)] = np.concatenate(simulated), si_units[n]
        manoeuvre = np.repeat(np.arange(len(firsts)), [len(p.time) for p in firsts])
        time = np.concatenate([p.time for p in firsts])
        groups[f"trajectories_{split}"] = _group(columns, tuple(named), manoeuvre, time)
    return groups


def column(output: str, kind: str) -> str:
    """A column's name; a slash in the name of a card's channel would open a group."""
    return f"{output}_{kind}".replace("/", "|")


def _group(
    columns: Mapping[str, tuple[np.ndarray, str]], names: Sequence[str], manoeuvre: Any, time: Any
) -> xr.Dataset:
    import xarray as xr

    about = {"long_name": "time as recorded, s"}  # xarray would make durations of what has the unit s
    data = {"time": ("sample", time, about), "manoeuvre": ("sample", manoeuvre + 1)}
    data |= {key: ("sample", x, {"units": unit}) for key, (x, unit) in columns.items()}
    return xr.Dataset(data, attrs={"names": [plain_line(name) for name in names]})


def put_histories(make: Callable[[], Histories], folder: Path) -> tuple[str, ...]:
    """Write `histories.nc`; if that fails an older file goes, and a sentence on it is returned."""
    import xarray as xr

    path = folder / HISTORIES
    try:
        groups = make()
        tree = xr.DataTree.from_dict({"/": xr.Dataset(attrs={"schema": "bayes_aero/histories/1"}), **groups})
        small = {"zlib": True, "complevel": 1}
        encoding = {f"/{key}": {str(name): small for name in group.data_vars} for key, group in groups.items()}
        write_whole(tree.to_netcdf(engine=ENGINE, encoding=encoding), path)
    except Exception as reason:  # whatever it is, the numbers stand
        path.unlink(missing_ok=True)
        return (failure(f"{HISTORIES} was not written", reason, folder),)
    return ()
