"""A finished result, found again: its records, its card, its model and its draws; its export to another simulator."""

from __future__ import annotations

import re
import shutil
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayes_aero import __version__
from bayes_aero.atomic_write import beside, put_folder, write_whole
from bayes_aero.dynamics.flight import LinearDynamics, linear_dynamics
from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.export.identified import Draws, Identified, about, validity
from bayes_aero.export.simulators import PROPERTIES, jsbsim_files, write_fmu
from bayes_aero.export.tables import write_tables
from bayes_aero.flight.card import Card, LinearCard, read_card, shipped_cards
from bayes_aero.flight.reading import read_again
from bayes_aero.flight.record import FlightRecord, segment_of
from bayes_aero.jobs.options import MOST_DRAWS
from bayes_aero.jobs.store import picked, read_result, result_file, safe_name, sha256_of, write_json
from bayes_aero.model.model import Model, effect_named, own_effects
from bayes_aero.model.records import Flights
from bayes_aero.physics.aircraft import COEFFICIENTS


def fitted_records(
    provenance: Mapping[str, Any],
    result: Path,
    card: Card,
    *,
    remedy: str,
    files: Sequence[Path] = (),
    folders: Sequence[Path] = (),
) -> list[FlightRecord]:
    """The records as they were read: from `files`, by name from `folders`, or from where the result says they are."""
    records = []
    for row in provenance["inputs"]:
        if row.get("read") is None or "content" not in row:
            how = "in memory, or by an earlier version; run the command again with a file"
            raise InputError(f"record {row['name']} of {result} was made {how}")
        path = Path(row["read"]["path"])
        places = [*(segment_of(file).file for file in files), *(folder / path.name for folder in folders)]
        for folder in (Path(), result.parent, result.parent.parent):
            places += dict.fromkeys((folder / path, folder / path.name))
        there = [place for place in places if place.is_file()]
        record = unchanged_record(row, card, there)
        if record is None and (changed := [place for place in there if place not in files]):
            raise InputError(f"record {changed[0]} has changed since {result} was made; {remedy} as it was")
        if record is None:
            where = f"in {folders[0]}" if folders else "where it was, nor beside the result, nor here"
            raise InputError(f"record {path.name} of {result} is not {where}; {remedy}")
        records.append(replace(record, name=row["name"]))
    return records


def unchanged_record(row: Mapping[str, Any], card: Card, there: Sequence[Path]) -> FlightRecord | None:
    """The record from the first file that is unchanged; else from one with the same samples, as written anew."""
    for path in there:
        if sha256_of(path) == row["sha256"]:
            return read_again(row["read"], path, card.channels)
    for path in there:
        with suppress(InputError):
            record = read_again(row["read"], path, card.channels)
            if record.content == row["content"]:
                return record
    return None


# --- The identified model of a finished result, or of a card that states values.

USABLE = ("converged", "at_bound")
COMMANDS = {"results": "identify", "trajectories": "fly", "diagnosis": "diagnose"}


@dataclass(frozen=True)
class FinishedResult:
    file: Path
    told: Mapping[str, Any]
    card: Card
    identified: Finished

    @property
    def folder(self) -> Path:
        return self.file.parent

    @property
    def command(self) -> str:
        return COMMANDS[self.told["schema"].split("/")[1]]

    @property
    def linear(self) -> IdentifiedLinear | None:
        return self.identified if isinstance(self.identified, IdentifiedLinear) else None

    @property
    def filtered(self) -> bool:
        """Whether a fit with process noise describes the record better than output error does."""
        return with_process_noise(self.told)

    def records(self, remedy: str, files: Sequence[Path] = (), folders: Sequence[Path] = ()) -> list[FlightRecord]:
        with as_written(self.file):
            made = self.told["provenance"]
            return fitted_records(made, self.file, self.card, remedy=remedy, files=files, folders=folders)


@contextmanager
def as_written(file: Path) -> Iterator[None]:
    try:
        yield
    except (KeyError, TypeError, AttributeError, ValueError) as reason:
        if isinstance(reason, InputError):
            raise
        raise InputError(f"{file} is not as bayes-aero wrote it ({reason!r}); run the command again") from None


def read_finished(given: str, card: str | None = None) -> FinishedResult:
    """The result in a folder or file; `card`: where it is not found by itself."""
    file = result_file(given)
    if file is None:
        raise InputError(f"{given} is a card; give the folder of a result of identify, fly or diagnose")
    results = read_result(file)
    with as_written(file):
        made_with = card_of(results["provenance"], file, card)
        return FinishedResult(file, results, made_with, model_of_result(results, file, made_with))


def read_identified(given: str, card: str | None = None) -> tuple[Identified, FinishedResult | None]:
    """The model of effects of a folder of results, of a result file, or (without a result) of a card at its values."""
    if result_file(given) is not None:
        result = read_finished(given, card)
        if isinstance(result.identified, IdentifiedLinear):
            raise InputError(f"card {result.identified.name} states a linear system; use one with [model]")
        return result.identified, result
    stated = read_card(given)
    model = Model.from_card(stated)
    values = {name: change.start for name, change in stated.changes.items() if change.start is not None}
    values |= dict(model.fixed)
    if missing := [p.name for p in model.parameters if p.name not in values]:
        raise InputError(
            f"card {stated.name} states no value of {', '.join(missing)}; give a result, or state start for each"
        )
    source = f"Values: as card {stated.name} states them ({stated.source}); sha256 {stated.sha256[:16]}."
    return Identified(stated.name, stated.title, model, stated.aircraft, values, (source,)), None


def model_of_result(results: Mapping[str, Any], file: Path, card: Card) -> Finished:
    estimates, causes, how = estimates_of(results, file)
    source = results["provenance"]
    records = ", ".join(f"{row['name']} (sha256 {row['sha256'][:16]})" for row in source["inputs"])
    made = source.get("versions", {}).get("bayes-aero", "of unknown version")
    origin = f"Records: {records}. Card {card.name} (sha256 {card.sha256[:16]}). Result of bayes-aero {made}."

    def complete(values: Mapping[str, float | None]) -> dict[str, float]:
        if lacking := [name for name, x in values.items() if x is None]:
            raise InputError(f"{file} has no value of {lacking[0]}; run the command again with this version")
        return {name: float(x) for name, x in values.items() if x is not None}

    if card.linear is not None:
        identified = IdentifiedLinear(card.name, card.title, card, {}, (how, origin), len(results["records"]))
        return replace(identified, values=complete({name: estimates.get(name) for name in identified.names}))
    model = fitted_model(card, estimates, causes, results)
    values = complete(dict(model.fixed) | {p.name: estimates.get(p.name) for p in model.free})
    ranges = [record.get("ranges", {}) for record in results["records"]]  # flown: lowest and highest of all records
    shared = set.intersection(*map(set, ranges)) if ranges else set()
    channels = [n for n in sorted(shared) if all(None not in pairs[n] for pairs in ranges)]
    flown = {n: (min(pairs[n][0] for pairs in ranges), max(pairs[n][1] for pairs in ranges)) for n in channels}
    return Identified(card.name, card.title, model, card.aircraft, values, (how, origin), flown)


def estimates_of(results: Mapping[str, Any], file: Path) -> tuple[dict[str, Any], list[str], str]:
    """Values by parameter, the causes that were added to the card's model, and a sentence on the method."""
    kind = results["schema"].split("/")[1]
    if kind == "diagnosis":
        if not results["base_parameters"]:
            raise InputError(f"{file} has no fitted parameters; there is no model to export")
        values = {name: move["after"] for name, move in results["base_parameters"].items()}
        causes = [cause for cause in results["causes"] if cause["confirmed"]]
        for cause in causes:
            values |= {name: size["mean"] for name, size in cause["parameters"].items()}
        names = [cause["name"] for cause in causes]
        added = f"the card's model with {', '.join(names)}" if names else "the card's model, to which nothing is added"
        return values, names, f"Values: {added} (diagnose)."
    fit, how = (results["mle"], "maximum likelihood on coefficients (identify)") if kind == "results" else (results, "")
    if fit["status"] not in USABLE:
        status = fit.get("advice") or fit["status"].replace("_", " ")
        raise InputError(f"the fit of {file} has not converged ({status}); there is no model to export")
    values = {name: p["estimate"] for name, p in fit["parameters"].items()}
    if with_process_noise(results):
        values |= {name: x for name, (x, _) in results["process_noise"]["estimates"].items()}
        how = "maximum likelihood on trajectories with process noise (fly)"
    return values, [], f"Values: {how or 'output error, maximum likelihood on trajectories (fly)'}."


def with_process_noise(results: Mapping[str, Any]) -> bool:
    filtered = results.get("process_noise")
    return filtered is not None and bool(filtered["converged"]) and (filtered["gain"] or 0.0) > 0.0


def fitted_model(card: Card, estimates: Mapping[str, Any], causes: Sequence[str], results: Mapping[str, Any]) -> Model:
    """The card's model on the axes that were recorded, for a fit leaves out the others, with the causes."""
    model = Model.from_card(card)
    fixed = dict(model.fixed)
    fitted = [e for e in model.effects if all(p.name in estimates or p.name in fixed for p in e.parameters)]
    if len(fitted) < len(model.effects):
        axes = tuple(a for a in model.axes if "mle" not in results or set(COEFFICIENTS[a]) & set(results["mle"]["fit"]))
        if "mle" not in results:
            axes = tuple(a for a in axes if any(e.axes == (a,) and e.parameters for e in fitted))
        there = {p.name for e in fitted for p in e.parameters}
        kept = [e for e in fitted if e.acts_on(axes) and set(e.uses) <= there]
        names = {p.name for e in kept for p in e.parameters}
        if not axes or not kept:
            raise InputError(f"the result has values of no effect of card {card.name}; run the command again")
        parameters = tuple(p for p in model.parameters if p.name in names)
        model = replace(model, axes=axes, effects=tuple(kept), parameters=parameters)
        fixed = {name: x for name, x in fixed.items() if name in names}
    freed = {p.name for e in model.effects if e.name in causes for p in e.parameters}  # held at neutral on the card
    model = replace(model, fixed=tuple((name, x) for name, x in fixed.items() if name not in freed))
    own_files, have = own_effects(card.effect_files), {e.name for e in model.effects}
    added: list[Effect] = [own_files.get(name) or effect_named(name) for name in causes if name not in have]
    return model.extended(*added) if added else model


# --- Draws of the parameters of a finished result: of its posterior, or of the normal distribution of its estimates.

SAMPLERS = ("nuts", "emcee")
TRIES = 50  # times as many normal draws are made until enough lie within the bounds


def no_draws(name: str) -> InputError:
    mend = "run the command of the result again, or leave --draws out"
    return InputError(f"{name}: neither a posterior that converged nor a covariance is there to draw from; {mend}")


def drawn(result: FinishedResult, wanted: Sequence[str], count: int, seed: int) -> Draws:
    """Draws of `wanted` by a posterior that converged, else normal with the corrected covariance, within the bounds."""
    if not 1 <= count <= MOST_DRAWS:
        raise InputError(f"--draws is {count}; give a number from 1 to {MOST_DRAWS}")
    rng, results, model = np.random.default_rng(seed), result.told, result.identified
    for sampler in SAMPLERS:
        status = results.get("posterior", {}).get("status", {}).get(sampler)
        file = result.folder / f"posterior_{sampler}.nc"
        if status is None or status["status"] != "converged" or not file.is_file():
            continue
        with xr.open_datatree(file, engine="h5netcdf") as tree:
            posterior = tree["posterior"].to_dataset()
            names = tuple(name for name in wanted if name in posterior)
            values = np.stack([np.asarray(posterior[name]).reshape(-1) for name in names], axis=1)
        if count > len(values):
            raise InputError(f"{file} has {len(values)} draws; give --draws {len(values)} or less")
        origin = f"posterior by {sampler} under {status['noise']} noise"
        return Draws(names, values[rng.choice(len(values), count, replace=False)], origin)
    if "causes" in results:  # a diagnosis
        stored = results.get("covariance") or {}
        rows, matrix = stored.get("parameters", ()), stored.get("matrix")
    else:
        part = results["process_noise"] if result.filtered else results.get("mle", results)
        rows, matrix = part["estimates" if result.filtered else "parameters"], part.get("covariance")
    if matrix is None:
        raise no_draws(model.name)
    # About the estimates, within the bounds; what the covariance does not know is left out.
    covariance = np.array(matrix, dtype=float)
    determined = [name in wanted and bool(np.all(np.isfinite(covariance[i]))) for i, name in enumerate(rows)]
    names = tuple(np.array(list(rows))[determined].tolist())
    low, high = np.array([model.bounds[name] for name in names]).T
    values, vectors = np.linalg.eigh(covariance[np.ix_(determined, determined)])
    white = rng.standard_normal((TRIES * count, len(names)))
    draws = np.array([model.values[name] for name in names]) + (white * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    draws = draws[np.all((draws >= low) & (draws <= high), axis=1)][:count]
    if len(draws) < count:
        raise InputError(
            f"{model.name}: draws of {', '.join(names)} lie beyond the bounds; sample it (identify, fly --posterior)"
        )
    held = [name for name in wanted if name not in names]
    of = "of the fit with process noise" if result.filtered else "corrected for coloured residuals"
    held_text = f"; {', '.join(held)} held at the estimate" if held else ""
    return Draws(names, draws, f"normal distribution of the estimates, covariance {of}{held_text}")


# --- The card of a finished result: results name it by its hash, and do not repeat it.


def card_of(provenance: Mapping[str, Any], result: Path, given: str | None) -> Card:
    """The card of a result: `given`, the shipped one, at the stated path, or beside the result or here."""
    name, sha256 = provenance["card"]["name"], provenance["card"]["sha256"]
    if given is not None:
        card = read_card(given)
        if card.sha256 != sha256:
            raise InputError(f"card {given} is not that of {result} (its content differs); give that with --model")
    else:
        shipped, stated = shipped_cards().get(name), provenance["card"].get("path")
        places = [Path(path) for path in (shipped, stated) if path]
        places += [folder / f"{name}.toml" for folder in (result.parent, result.parent.parent, Path())]
        path = next((p for p in places if p.is_file() and sha256_of(p) == sha256), None)
        if path is None:
            raise InputError(f"{result} was made with card {name}, not found here unchanged; give it with --model")
        card = read_card(name if shipped == path else path)
    now = {path.name: sha256_of(path) for path in card.effect_files if path.is_file()}
    for file in provenance.get("effect_files", ()):
        if now.get(file["name"]) != file["sha256"]:
            raise InputError(f"effect file {file['name']} has changed since {result} was made; run the command again")
    return card


# --- The linear system of a card with the values that a finished result has found.


@dataclass(frozen=True)
class IdentifiedLinear:
    """A linear system with values, SI; constants that differ between the `manoeuvres` fitted have a value for each."""

    name: str
    title: str
    card: Card
    values: Mapping[str, float]
    sources: tuple[str, ...]
    manoeuvres: int

    @property
    def rows(self) -> LinearCard:
        assert self.card.linear is not None
        return self.card.linear

    @cached_property
    def fitted(self) -> LinearDynamics:
        return linear_dynamics(self.card, (1,) * self.manoeuvres)

    @property
    def names(self) -> tuple[str, ...]:
        return self.fitted.names

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        return {p.name: p.bounds for p in self.fitted.free}

    def dynamics(self, flights: Flights) -> LinearDynamics:
        return linear_dynamics(self.card, flights.lengths)


Finished = Identified | IdentifiedLinear


# --- The job of `bayes-aero export`: an identified model in the form of another simulator, in a folder of its own.

WIDTH = 100


def export(
    given: str, form: str, *, out: Path | None = None, card: str | None = None, draws: int = 0, seed: int = 0
) -> tuple[Path, dict[str, Any]]:
    """Write the model of a result, or of a card that states all values, as `form`, one of `FORMS`, into the new folder
    `out` (default NAME_FORM), with `draws`. Returns the folder, and what export.json says."""
    if form not in FORMS:
        raise InputError(f"there is no form {form!r} to export to; give one of {', '.join(FORMS)}")
    identified, result = read_identified(given, card)
    identified = _renamed(identified)
    if draws:
        if result is None:
            raise no_draws(identified.name)
        needed = [p.name for p in identified.exported.free if p.name in identified.program.inputs_of("parameter")]
        identified = replace(identified, draws=drawn(result, needed, draws, seed))
    target = out or Path(f"{identified.name}_{form}")
    return target, write_export(identified, form, target)


def write_export(identified: Identified, form: str, target: Path) -> dict[str, Any]:
    identified = _renamed(identified)
    if target.exists() or target.is_symlink():
        raise InputError(f"{target} exists; give another folder with --out")
    part = beside(target.absolute())
    try:
        part.mkdir(parents=True)
        facts = export_facts(identified, form, FORMS[form](identified, part))
        write_json(facts, part / "export.json")
        use = [USE[form].format(name=identified.name)]
        if form == "jsbsim":
            table = [f"{n}: {PROPERTIES[n][0]}" for n in identified.program.inputs_of("signal") if n in PROPERTIES]
            use.append(f"Read from JSBSim: {'; '.join(table)}.")
        lines = [textwrap.fill(sentence, WIDTH) for sentence in (*about(identified), *use)]
        write_whole("\n".join(lines) + "\n", part / "README.txt")
        if identified.draws is not None:
            frame = pd.DataFrame(identified.draws.values, columns=list(identified.draws.names))
            write_whole(frame.to_csv(index=False), part / "draws.csv")
        put_folder(part, target.absolute())
    except OSError as reason:
        raise InputError(f"cannot write {target} ({reason.strerror or reason}); give another --out") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return facts


def _renamed(identified: Identified) -> Identified:
    """The model under a name that is one in XML and for every system's files."""
    name = re.sub(r"[^A-Za-z0-9_]", "_", identified.name)
    return replace(identified, name=safe_name(name if re.match(r"[A-Za-z_]", name) else f"_{name}"))


def write_jsbsim(identified: Identified, folder: Path) -> tuple[str, ...]:
    files = jsbsim_files(identified)
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        write_whole(text, folder / name)
    return tuple(files)


FORMS: dict[str, Callable[[Identified, Path], tuple[str, ...]]] = {
    "jsbsim": write_jsbsim,
    "fmu": lambda identified, folder: (write_fmu(identified, folder).name,),
    "tables": write_tables,
}


def export_facts(model: Identified, form: str, files: tuple[str, ...]) -> dict[str, Any]:
    read = model.program.inputs_of("parameter")
    return {
        "schema": "bayes_aero/export/1",
        **picked(model, "name", "title"),
        "form": form,
        "version": f"bayes_aero {__version__}",
        "files": list(files),
        "parameters": {
            p.name: {"value": model.values[p.name], "unit": p.unit} for p in model.exported.parameters if p.name in read
        },
        "inputs": list(model.program.inputs_of("signal")),
        "states": list(model.program.inputs_of("state")),
        "outputs": list(model.program.outputs),
        "flown": {name: list(model.flown[name]) for name in model.signals if name in model.flown},
        "sources": list(model.sources),
        "validity": list(validity(model)),
        "draws": None if model.draws is None else {"count": len(model.draws.values), "origin": model.draws.origin},
        "left_out": list(model.left_out),
    }


USE = {  # how the files of a form are used
    "jsbsim": "This folder is a root directory of JSBSim with the aircraft {name}. For your own aircraft take the "
    "files of aerodynamics and of the system, put the system before the aerodynamics, and set AERORP to the "
    "aerodynamic reference point. The system declares what JSBSim does not have, bayes-aero/input/...",
    "fmu": "FMI 2.0, co-simulation; it runs where Python runs. The time step solves the separation lag exactly.",
    "tables": "A coefficient is the sum of its tables, each interpolated linearly; interpolation_error is the sum of "
    "the largest errors along the axes. X is an axis: take the incidence from its tables, the static X from X_static, "
    "and X through its lag where there is one.",
}
