"""The identified model of a finished result, or of a card that states values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bayes_aero.effect import Effect
from bayes_aero.errors import InputError
from bayes_aero.export.identified import Identified
from bayes_aero.flight.card.card import Card, read_card
from bayes_aero.jobs.handover.identified_card import card_of
from bayes_aero.jobs.handover.identified_linear import Finished, IdentifiedLinear
from bayes_aero.jobs.handover.result_file import read_result, result_file
from bayes_aero.model.chosen import effect_named
from bayes_aero.model.model import Model
from bayes_aero.model.own_effects import own_effects
from bayes_aero.physics.coefficient_names import COEFFICIENTS

USABLE = ("converged", "at_bound")


def read_identified(given: str, card: str | None = None) -> tuple[Identified, Path | None, Mapping[str, Any]]:
    """The model of effects of a folder of results, of a result file, or of a card; see `read_finished`.

    Raises:
        InputError: also where the card states a linear system.
    """
    found, folder, told = read_finished(given, card)
    if isinstance(found, IdentifiedLinear):
        raise InputError(
            f"card {found.name} states a linear system, which has no coefficients to export; use a result of a card "
            "with [model]"
        )
    return found, folder, told


def read_finished(given: str, card: str | None = None) -> tuple[Finished, Path | None, Mapping[str, Any]]:
    """The model of a folder of results, of a result file, or of a card; that of a result may be a linear system.

    Args:
        given: path of the folder or file, or the name of a shipped card.
        card: the card of the result, where it is not found by itself.

    Returns:
        The model with its values; the folder of the result (None: a card) and the result itself.

    Raises:
        InputError: there is no such folder or card, the fit did not converge, or a parameter has no value.
    """
    file = result_file(given)
    if file is None:
        return _of_card(read_card(given)), None, {}
    told = read_result(file)
    try:
        found = _of_result(told, file, card_of(told["provenance"], file, card))
    except (KeyError, TypeError, AttributeError, ValueError) as reason:
        if isinstance(reason, InputError):
            raise
        raise InputError(f"{file} is not as bayes-aero wrote it ({reason!r}); run the command again") from None
    return found, file.parent, told


def _of_card(card: Card) -> Identified:
    model = Model.from_card(card)
    stated = {name: change.start for name, change in card.changes.items() if change.start is not None}
    values = dict(model.fixed) | {name: x for name, x in stated.items() if name not in dict(model.fixed)}
    missing = [p.name for p in model.parameters if p.name not in values]
    if missing:
        raise InputError(
            f"card {card.name} states no value of {', '.join(missing)}; give a result of identify, fly or diagnose, or "
            f"state start under [parameters.{missing[0]}]"
        )
    sources = (f"Values: as card {card.name} states them ({card.source}); sha256 {card.sha256[:16]}.",)
    return Identified(card.name, card.title, model, card.aircraft, values, sources)


def _of_result(told: Mapping[str, Any], file: Path, card: Card) -> Finished:
    kind = told["schema"].split("/")[1]
    estimates, causes, how = {"results": _identified, "trajectories": _flown, "diagnosis": _diagnosed}[kind](told, file)
    if card.linear is not None:
        found = IdentifiedLinear(card, {}, (how, _origin(told, card)), len(told["records"]))
        return replace(found, values=_complete({name: estimates.get(name) for name in found.names}, file))
    model = _extended(_recorded(Model.from_card(card), card, estimates, told), card, causes)
    values = dict(model.fixed) | {p.name: estimates.get(p.name) for p in model.free}
    return Identified(
        card.name,
        card.title,
        model,
        card.aircraft,
        _complete(values, file),
        (how, _origin(told, card)),
        _flown_ranges(told["records"]),
    )


def _complete(values: Mapping[str, float | None], file: Path) -> dict[str, float]:
    """The same, with a value of every parameter."""
    for name, x in values.items():
        if x is None:
            raise InputError(f"{file} has no value of {name}; run the command again with this version")
    return {name: float(x) for name, x in values.items() if x is not None}


def _identified(told: Mapping[str, Any], file: Path) -> tuple[dict[str, Any], list[str], str]:
    mle = told["mle"]
    if mle["status"] not in USABLE:
        raise InputError(f"the fit of {file} has not converged ({mle['advice']}); there is no model to export")
    values = {name: p["estimate"] for name, p in mle["parameters"].items()}
    return values, [], "Values: maximum likelihood on coefficients (identify)."


def _flown(told: Mapping[str, Any], file: Path) -> tuple[dict[str, Any], list[str], str]:
    if not told["converged"]:
        raise InputError(
            f"the fit of {file} has not converged ({told['status'].replace('_', ' ')}); there is no model to export"
        )
    values = {name: p["estimate"] for name, p in told["parameters"].items()}
    if with_process_noise(told):
        values |= {name: x for name, (x, _) in told["process_noise"]["estimates"].items()}
        return values, [], "Values: maximum likelihood on trajectories with process noise (fly)."
    return values, [], "Values: output error, maximum likelihood on trajectories (fly)."


def with_process_noise(told: Mapping[str, Any]) -> bool:
    """Whether a fit with process noise describes the record better than output error does."""
    filtered = told.get("process_noise")
    return filtered is not None and bool(filtered["converged"]) and (filtered["gain"] or 0.0) > 0.0


def _diagnosed(told: Mapping[str, Any], file: Path) -> tuple[dict[str, Any], list[str], str]:
    if not told["base_parameters"]:
        raise InputError(f"{file} has no fitted parameters; there is no model to export")
    values = {name: move["after"] for name, move in told["base_parameters"].items()}
    causes = [cause for cause in told["causes"] if cause["confirmed"]]
    for cause in causes:
        values |= {name: size["mean"] for name, size in cause["parameters"].items()}
    names = [cause["name"] for cause in causes]
    added = f"the card's model with {', '.join(names)}" if names else "the card's model, to which nothing is added"
    return values, names, f"Values: {added} (diagnose)."


def _recorded(model: Model, card: Card, estimates: Mapping[str, Any], told: Mapping[str, Any]) -> Model:
    """The card's model on the axes that were recorded: a fit leaves out the others."""
    fixed = dict(model.fixed)
    known = [e for e in model.effects if all(p.name in estimates or p.name in fixed for p in e.parameters)]
    if len(known) == len(model.effects):
        return model
    fitted = told["mle"]["fit"] if "mle" in told else told.get("fitted_outputs", ())
    axes = tuple(a for a in model.axes if "mle" not in told or set(COEFFICIENTS[a]) & set(fitted))
    if "mle" not in told:
        axes = tuple(a for a in axes if any(e.axes == (a,) and e.parameters for e in known))
    own = {p.name for e in known for p in e.parameters}
    kept = [e for e in known if e.acts_on(axes) and set(e.uses) <= own]
    names = {p.name for e in kept for p in e.parameters}
    if not axes or not kept:
        raise InputError(f"the result has values of no effect of card {card.name}; run the command again")
    return replace(
        model,
        axes=axes,
        effects=tuple(kept),
        parameters=tuple(p for p in model.parameters if p.name in names),
        fixed=tuple((name, x) for name, x in model.fixed if name in names),
    )


def _extended(model: Model, card: Card, causes: Sequence[str]) -> Model:
    """The model with causes; an effect of the card that was held at neutral is freed."""
    own = own_effects(card.effect_files)
    there = {e.name for e in model.effects}
    freed = {p.name for e in model.effects if e.name in causes for p in e.parameters}
    model = replace(model, fixed=tuple((name, x) for name, x in model.fixed if name not in freed))
    added: list[Effect] = [own.get(name) or effect_named(name) for name in causes if name not in there]
    return model.extended(*added) if added else model


def _origin(told: Mapping[str, Any], card: Card) -> str:
    source = told["provenance"]
    records = ", ".join(f"{one['name']} (sha256 {one['sha256'][:16]})" for one in source["inputs"])
    made = source.get("versions", {}).get("bayes-aero", "of unknown version")
    return f"Records: {records}. Card {card.name} (sha256 {card.sha256[:16]}). Result of bayes-aero {made}."


def _flown_ranges(records: Sequence[Mapping[str, Any]]) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each channel that all records have."""
    ranges = [record.get("ranges", {}) for record in records]
    shared = set.intersection(*(set(one) for one in ranges)) if ranges else set()
    known = [n for n in sorted(shared) if all(None not in one[n] for one in ranges)]
    return {n: (min(one[n][0] for one in ranges), max(one[n][1] for one in ranges)) for n in known}
