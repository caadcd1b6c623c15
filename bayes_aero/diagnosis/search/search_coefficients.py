"""The search for missing effects in coefficients: the flight path first, then the model, then what has no name."""

from __future__ import annotations

from collections.abc import Sequence

from bayes_aero.diagnosis.candidate_set import candidate_model
from bayes_aero.diagnosis.result import COEFFICIENTS, FLIGHT_PATH
from bayes_aero.diagnosis.screening.accuracy import filtered_channels
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.search.search_result import SearchResult
from bayes_aero.diagnosis.search.stages import Stages, search_in_stages
from bayes_aero.diagnosis.selection.residuals import noise_report
from bayes_aero.diagnosis.settings import DiagnosisSettings
from bayes_aero.diagnosis.structure.components import has_chunks
from bayes_aero.diagnosis.structure.unexplained import Left, offsets_found, unexplained, withdrawn
from bayes_aero.diagnosis.terms.forms import Forms, described, forms_of
from bayes_aero.effect import Effect
from bayes_aero.errors import attempted
from bayes_aero.flight.card.card import Card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.model.joined_channels import Flights, despiked, join
from bayes_aero.model.model import Model
from bayes_aero.model.observations import observe
from bayes_aero.physics.coefficient_names import required_of
from bayes_aero.progress import Progress
from bayes_aero.residuals.equation_error import EquationError


def search_coefficients(
    records: Sequence[FlightRecord],
    card: Card,
    model: Model,
    extra: Sequence[Effect],
    settings: DiagnosisSettings,
    *,
    seed: int,
    progress: Progress | None = None,
) -> SearchResult:
    """Search where coefficients can be formed; `extra` effects stand beside the catalogue's."""
    flights, outliers = despiked(join(records, card, required_of(model.axes)))
    full = candidate_model(model, flights, extra, settings)
    mle = fit_mle(model, observe(records, card, model), seed=seed)
    theta = full.neutral_vector
    for name, value in zip(mle.names, mle.estimate, strict=True):
        if name in full.model.names:
            theta[full.columns([name])[0]] = value
    both = search_in_stages(full, EquationError.of(flights, full.model), theta, seed=seed, progress=progress)
    left, failures = attempted(
        "Unexplained structure was not sought",
        lambda: unexplained(both.aerodynamics, seed=seed + 2000),
        Left((), ()),
    )
    found, failed = attempted(
        "The form of unexplained structure was not sought",
        lambda: forms_of(both.aerodynamics, left, seed=seed + 3000),
        Forms((), ()),
    )
    aerodynamics = withdrawn(both.aerodynamics, (*left.replaced, *found.replaced), found.sizes)
    named = [] if both.sensors is None else [(FLIGHT_PATH, both.sensors)]
    return SearchResult(
        full,
        (*named, (COEFFICIENTS, aerodynamics)),
        (*described(left.unknown, found), *offsets_found(aerodynamics, found.idle)),
        noise_report(aerodynamics, outliers),
        (*_filtered(flights), *_too_short(aerodynamics.state), *_denials(both)),
        (*failures, *failed),
        changes=left.changes,
        terms=found.terms,
        forms=found.rivals,
    )


def _filtered(flights: Flights) -> tuple[str, ...]:
    """What the user should know of the intervals."""
    filtered = filtered_channels(flights)
    if not filtered:
        return ()
    return (
        f"The record shows no white noise of {', '.join(filtered)} (filtered before recording, or none): sizes are not "
        "corrected for the bias from such noise, and their intervals do not include it.",
    )


def _too_short(state: SelectionState) -> tuple[str, ...]:
    """That periods were not tested, if a manoeuvre is too short for them."""
    if has_chunks(state):
        return ()
    return ("Periodic structure was not tested: a manoeuvre is too short to be divided into blocks.",)


def _denials(found: Stages) -> tuple[str, ...]:
    """A sentence on each sensor error that the flight path selects and the coefficients reject."""
    return tuple(
        f"The flight path alone selects {name}, which can be due to gusts. This correction degrades the fit of the "
        "coefficients by more than the flight path gains, so it is not made."
        for name in found.denied
    )
