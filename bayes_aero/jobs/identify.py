"""The main job: records in, parameters with uncertainty out, every finished stage on disk before the next begins."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import xarray as xr

from bayes_aero.diagnosis.consistency.filter_mismatch import filter_mismatch_notes
from bayes_aero.diagnosis.trajectories.time_histories import Path as Flown
from bayes_aero.errors import InputError, attempted
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.health import channel_health
from bayes_aero.flight.reading.common_rate import rate_notes
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.identification import Identification
from bayes_aero.inference.likelihood.mle import MOST_ALONE, fit_alone, fit_mle
from bayes_aero.inference.likelihood.noise_bias import without_noise_bias
from bayes_aero.inference.posterior.checkpoint import Checkpoint
from bayes_aero.inference.posterior.ensemble import sample_ensemble
from bayes_aero.inference.posterior.laplace import density_start, other_modes, search_modes
from bayes_aero.inference.posterior.nuts import sample_nuts
from bayes_aero.inference.posterior.posterior import Posterior, PosteriorStatus
from bayes_aero.inference.posterior.prior_sensitivity import prior_sensitivity
from bayes_aero.inference.splits import SplitKind
from bayes_aero.inference.stall import Stall, stall_of_posterior
from bayes_aero.inference.validation import validate
from bayes_aero.jobs.io.identification_json import results
from bayes_aero.jobs.io.output_folder import writable
from bayes_aero.jobs.io.time_histories import identified, put_histories
from bayes_aero.jobs.provenance.environment import rests_on
from bayes_aero.jobs.provenance.provenance import provenance, write_json
from bayes_aero.jobs.steps.identified_flight import fly_identified
from bayes_aero.jobs.steps.sensors_first import sensors_agree
from bayes_aero.jobs.steps.spike_repair import repaired
from bayes_aero.model.density import Density
from bayes_aero.model.model import Model
from bayes_aero.model.noise import DEFAULT as DEFAULT_NOISE
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import Forming, observe
from bayes_aero.progress import Progress
from bayes_aero.report.figures.every_figure import FIGURES, write_figures
from bayes_aero.report.html.page import put_page
from bayes_aero.report.pages.identification import identification_page
from bayes_aero.report.style import MOST_MANOEUVRES
from bayes_aero.report.tables.run_tables import paper_table, parameter_table, validation_table, write_csv
from bayes_aero.report.text.identification import verdict
from bayes_aero.report.text.restraints import leaning_sentences

CHAINS = ".chains"


def identify(
    records: Sequence[FlightRecord],
    card: Card,
    *,
    noise: Colour = DEFAULT_NOISE,
    coefficients: str = Forming.MATCHED,
    split: SplitKind = "random",
    seed: int = 0,
    out: Path | None = None,
    sample: bool = True,
    gp: bool = True,
    approximate_gp: bool = False,
    figures: bool = True,
    resume: bool = True,
    page: bool = True,
    truth: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> Identification:
    """Fit, sample and compare, as `bayes-aero identify` does; with `out` every stage is written as it ends.

    With `out` and `resume` emcee's chains are on disk as they grow, in `out`/.chains until the run is complete: the
    same call after a kill goes on with them, if records, card, settings and versions are the same.

    `coefficients` are formed from signals all filtered alike (`matched`) or as the published ones (`published`).
    Without `sample` maximum likelihood alone stands for the parameters; without `page` no report.html is made. `split`
    chooses the split whose Gaussian-process hyperparameters are sampled; scores are given for all splits. `truth` has
    the parameters that simulated records were flown with: they are shown beside the estimates.
    """
    model = Model.from_card(card)
    forming = Forming(coefficients)
    without_spikes, spikes = repaired(records)
    observations = observe(without_spikes, card, model, forming)
    seconds: dict[str, float] = {}
    settings = {"noise": noise.value, "split": split, "coefficients": forming.value}
    writer = _Writer(out, provenance(card, records, seed, settings))
    trying = partial(attempted, folder=out, own=bool(card.effect_files))
    with _timed(seconds, "do the sensors agree?", progress):
        agreement, failures = sensors_agree(records, card, seed, out)
    with _timed(seconds, "mle", progress):
        mle = raw = fit_mle(model, observations, seed=seed)
        if forming is Forming.MATCHED:
            mle, failed = trying(
                "The bias from sensor noise was not subtracted from the estimates",
                lambda: without_noise_bias(raw, without_spikes, card, model, seed=seed),
                raw,
            )
            failures += failed
        alone, failed = trying(
            "Manoeuvres were not fitted alone", lambda: fit_alone(model, observations, seed=seed), {}
        )
        failures += failed
        told = filter_mismatch_notes(without_spikes, card, model, mle) if forming is Forming.PUBLISHED else ()
    run = Identification(
        card,
        model,
        tuple(records),
        observations,
        noise,
        mle,
        alone,
        {},
        notes=(*spikes, *_rates(records, forming), *_many(len(records))),
        failures=failures,
        health=channel_health(records, card),
        preparation=told,
        consistency=agreement,
        truth=truth,
        seconds=seconds,
        forming=forming,
    )
    writer.stage(run)
    if out is not None:  # they are for the page and the file alone
        with _timed(seconds, "flights", progress):
            writer.flown, told, failed = fly_identified(records, card, model, mle, out)
        run = _with(run, told, (*failed, *put_histories(lambda: identified(run), out)))
        writer.stage(run)
    chains = None if out is None else out / CHAINS
    stores = None if chains is None or not resume else _stores(chains, card, records, seed, forming)

    for key, colour, engine in _plan(noise) if sample else ():
        with _timed(seconds, key, progress):
            kept: dict[str, Any] = {}
            if stores is not None and engine is sample_ensemble:
                kept["checkpoint"] = stores(f"{key}_{colour.value}")
            sampled, failed = trying(
                f"The posterior by {key} under {colour.value} noise was not sampled",
                partial(_sampled, run, key, colour, engine, seed=seed, progress=progress, **kept),
                None,
            )
        run = _with(run, (), failed)
        if sampled is not None:
            posterior, told = sampled
            run = _with(replace(run, posteriors=run.posteriors | {key: posterior}), told)
            writer.stage(run, posterior_name=key)

    if gp:
        options = {"chosen": split, "seed": seed, "approximate": approximate_gp, "progress": progress}
        try:
            with _timed(seconds, "gp", progress):
                report, failed = trying(
                    "Gaussian process left out",
                    lambda: validate(model, observations, mle, card.gp_inputs, **options),
                    None,
                )
            run = _with(replace(run, gp=report), () if report is None else report.left_out, failed)
        except InputError as error:  # too large for the exact process: said, and the rest stands
            run = _with(run, (f"Gaussian process left out: {error}",))
        writer.stage(run, gp_done=True)
    with _timed(seconds, "stall", progress):
        stall, failed = trying("Stall left out", partial(_stall, run), None)
        run = _with(replace(run, stall=stall), (), failed)
    drawn: list[Path] = []
    if figures and out is not None:
        with _timed(seconds, "figures", progress):
            drawn, failed = write_figures(run, out / "figures", progress=progress)
        run = _with(run, (), failed)
    writer.stage(run)
    if page and out is not None:
        pictures = {p.stem: p for p in drawn}
        with _timed(seconds, "report", progress):
            failed = put_page(lambda: identification_page(run, writer.source, pictures, writer.flown), out)
        if failed:
            run = _with(run, (), failed)
            writer.stage(run)
    if chains is not None and not run.failures:
        shutil.rmtree(chains, ignore_errors=True)
    writer.remove_older(run, page=page, figures=figures)
    return run


def _rates(records: Sequence[FlightRecord], forming: Forming) -> tuple[str, ...]:
    return rate_notes(records) if forming is Forming.MATCHED else ()


def _many(manoeuvres: int) -> tuple[str, ...]:
    """What is left out because there are so many."""
    said = []
    if manoeuvres > MOST_ALONE:
        said.append(f"{manoeuvres} manoeuvres are fitted jointly; beyond {MOST_ALONE} none is fitted by itself.")
    if manoeuvres > MOST_MANOEUVRES:
        said.append(f"Figures with a panel for each manoeuvre are drawn for up to {MOST_MANOEUVRES} of them.")
    return tuple(said)


def _stores(
    folder: Path, card: Card, records: Sequence[FlightRecord], seed: int, forming: Forming
) -> Callable[[str], Checkpoint]:
    """Where the chain of each posterior is kept while it grows, and all that its numbers rest on."""
    source = provenance(card, records, seed, {})
    made_from = rests_on(source, records) | {"coefficients": forming.value}
    return lambda key: Checkpoint(folder / key, made_from | {"posterior": key})


def _with(run: Identification, notes: Sequence[str] = (), failures: Sequence[str] = ()) -> Identification:
    """The run with more to be told."""
    return replace(run, notes=(*run.notes, *notes), failures=(*run.failures, *failures))


def _sampled(
    run: Identification, key: str, colour: Colour, engine: Any, *, seed: int, progress: Progress | None, **kept: Any
) -> tuple[Posterior, tuple[str, ...]]:
    """A posterior, with what is said of its other modes and of the priors that it leans on."""
    density = Density.of(run.observations, run.model, Noise(colour), run.mle.bias)
    mode = search_modes(density, density_start(density, run.mle), run.observations.n, seed=seed)
    posterior = engine(density, mode, seed=seed, progress=progress, **kept)
    told = other_modes(mode, f"{key}, {colour.value} noise")
    if run.mle.conflicts and key == "emcee":
        told += leaning_sentences(prior_sensitivity(density, posterior), run.mle.conflicts)
    return posterior, told


def _stall(run: Identification) -> Stall | None:
    """CLmax and its angle from the first posterior that converged; without one there is none."""
    for key, posterior in run.posteriors.items():
        if key != "white" and posterior.status is PosteriorStatus.CONVERGED:
            o = run.observations
            return stall_of_posterior(run.model, posterior, o.signals, o.aircraft)
    return None


def _plan(noise: Colour) -> list[tuple[str, Colour, Any]]:
    """Which posteriors are sampled, under which noise model and by which engine."""
    plan = [("emcee", noise, sample_ensemble), ("nuts", noise, sample_nuts)]
    return plan if noise is Colour.WHITE else [*plan, ("white", Colour.WHITE, sample_ensemble)]


@contextmanager
def _timed(seconds: dict[str, float], stage: str, progress: Progress | None) -> Iterator[None]:
    if progress:
        progress(stage, 0.0)
    began = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - began
    if progress:
        progress(stage, 1.0)


class _Writer:
    """Writes what a run has found so far; without a folder it writes nothing."""

    def __init__(self, out: Path | None, source: dict[str, Any]) -> None:
        self.out, self.source = out, source
        self.flown: tuple[Flown, ...] = ()
        if out is not None:
            writable(out)

    def stage(self, run: Identification, posterior_name: str | None = None, gp_done: bool = False) -> None:
        if self.out is None:
            return
        if posterior_name is not None:
            run.posteriors[posterior_name].save(self.out / f"posterior_{posterior_name}.nc")
        if run.gp is not None and gp_done:
            save_gp(run, self.out / "gpr.nc")
        write_csv(parameter_table(run), self.out / "parameters.csv")
        if run.gp is not None:
            write_csv(validation_table(run), self.out / "validation.csv")
            write_csv(paper_table(run), self.out / "table1.csv")
        write_json(results(run, verdict(run), self.source, self.flown), self.out / "results.json")

    def remove_older(self, run: Identification, *, page: bool, figures: bool) -> None:
        """Take away what an earlier run has left in the folder and this one, now complete, has no successor for."""
        if self.out is None:
            return
        older = {self.out / f"posterior_{key}.nc" for key in ("emcee", "nuts", "white") if key not in run.posteriors}
        if run.gp is None:
            older |= {self.out / name for name in ("gpr.nc", "validation.csv", "table1.csv")}
        if not page:
            older.add(self.out / "report.html")
        if not figures:
            older |= {self.out / "figures" / f"{stem}.png" for stem in FIGURES}
        for path in older:
            path.unlink(missing_ok=True)


def save_gp(run: Identification, path: Path) -> None:
    """gpr.nc: a group per coefficient with its hyperparameters' posterior, and the validation of every split."""
    assert run.gp is not None
    tree = xr.DataTree(name="gpr")
    for name, fit in run.gp.fits.items():
        if fit.posterior is not None:
            tree[name] = fit.posterior.copy()
    for split, folds in run.gp.splits.items():
        for number, fold in enumerate(folds):
            for name, v in fold.items():
                columns = {k: ("test", getattr(v, k)) for k in ("measured", "gp", "gp_low", "gp_high", "mle")}
                tree[f"validation/{split}_{number}/{name}"] = xr.DataTree(
                    xr.Dataset(columns, coords={"index": ("test", v.test)})
                )
    partial = path.with_name(path.name + ".part")
    tree.to_netcdf(partial, engine="h5netcdf")
    partial.replace(path)
