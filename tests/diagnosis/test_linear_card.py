"""A linear model flown into the stall: diagnosis finds the separation of the flow and what depends on it."""

import numpy as np
import pytest
import six_axes
from stranger_six import Fighter, fly

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.result import TRAJECTORIES
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.model import Model
from bayes_aero.simulate.injection import hidden_flights

LINEAR = (
    "attached_lift", "mach_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag",
)  # fmt: skip
STALL = {"flow_separation", "reattachment_hysteresis", "separated_moment", "separated_drag"}


@pytest.mark.verify
def test_a_linear_model_is_extended_to_the_stall_that_was_flown(card):
    seed = int(np.random.default_rng(611).integers(1_000_000))
    flights = hidden_flights({}, seed=seed, noise="ar1", seconds=90.0)
    records, truth = [flight.record for flight in flights], flights[0].values
    found = diagnose(records, card, model=Model.of(LINEAR), seed=seed, gains_wanted=False)
    assert {cause.name for cause in found.causes} == STALL
    assert found.causes[0].name == "flow_separation"
    for cause in found.causes:
        for name, size in cause.parameters.items():
            assert size.mean == pytest.approx(truth[name], rel=0.15), name
    assert not found.unknown


FORMS = {
    "pitch_rate_lift", "aileron_side_force", "roll_rate_side_force", "sideslip_alpha_roll", "sideslip_alpha_yaw",
    "sideslip_cubed_roll", "sideslip_cubed_yaw", "sideslip_lift", "sideslip_drag", "sideslip_moment",
    "alpha_squared_moment", "alpha_drag", "elevator_drag", "cg_shift",
}  # fmt: skip
"""Effects that are terms of the fighter's polynomials by another name; its Cm has 0.05 CZ, a shift of the CG."""


def polynomial_fighter(folder, plane, plan, rng, seconds, *axes):
    """A linear card and records of manoeuvres (speed, kind)."""
    effects = six_axes.LONGITUDINAL + (six_axes.LATERAL if len(axes) > 1 else ())
    (folder / "card.toml").write_text(six_axes.card_text(plane, effects, axes), encoding="utf-8")
    flights = [fly(plane, kind, rng, seconds=seconds, V=speed) for speed, kind in plan]
    records = [six_axes.record(f"m{k}_{speed:.0f}", flights[k], rng) for k, (speed, _) in enumerate(plan)]
    return records, read_card(str(folder / "card.toml"))


@pytest.mark.recovery
def test_a_wrong_form_of_the_coefficients_is_no_stall_and_no_camber(tmp_path):
    """A fighter of polynomials, by a simulator that shares no code, from 2 to 24 deg: what is found are forms.

    With the linear card `drag_offset` and `flow_separation` explain most of what is left, and CL differs between
    manoeuvres, whose angles of attack do. None of that is there. CZq is -30 per q c/2V: lift by pitch rate is 15 qhat.
    """
    plan = [(speed, "elevator") for speed in (190.0, 120.0, 90.0, 75.0) for _ in range(2)]
    records, card = polynomial_fighter(tmp_path, Fighter(), plan, np.random.default_rng([1, 54]), 10.0, "longitudinal")
    found = diagnose(records, card, seed=1, gains_wanted=False, process_noise=False)
    assert not found.causes
    assert not any(structure.offsets for structure in found.unknown)
    assert {term.coefficient for term in found.terms} == {"CL", "CD", "Cm"}
    assert {channel for term in found.terms for channel in term.term.channels} <= {"alpha", "q", "airspeed", "elevator"}
    ((mean, sd),) = [term.size for term in found.terms if (term.coefficient, term.term.name) == ("CL", "qhat")]
    assert abs(mean - 15.0) < 4.0 * sd


@pytest.mark.verify
def test_a_wrong_form_is_no_camber_where_trajectories_are_compared(tmp_path):
    """The same fighter without accelerometers. Forms are sought to first order there, so few of them are sure."""
    plan = [(speed, "elevator") for speed in (190.0, 120.0, 90.0, 75.0) for _ in range(2)]
    records, card = polynomial_fighter(tmp_path, Fighter(), plan, np.random.default_rng([1, 54]), 10.0, "longitudinal")
    kept = [{name: x for name, x in r.channels.items() if name not in ("ax", "ay", "az")} for r in records]
    flown = [FlightRecord.from_arrays(r.name, r.time, x) for r, x in zip(records, kept, strict=True)]
    found = diagnose(flown, card, seed=1, gains_wanted=False, process_noise=False)
    assert found.compared == TRAJECTORIES
    assert not found.causes
    assert {term.coefficient for term in found.terms} == {"CL", "CD", "Cm"}
    assert "alpha" in next(t for t in found.terms if t.coefficient == "CL").term.channels


@pytest.fixture(scope="module")
def nonlinear(request, tmp_path_factory):
    """Curves, tables and what depends on deflections are drawn; three axes in every other flight, few or many."""
    seed = request.param
    rng = np.random.default_rng([seed, 531])
    plane, six, few = Fighter.drawn(rng), seed % 2 == 1, seed > 1
    kinds = ("elevator", "aileron", "rudder") if six else ("elevator", "elevator")
    plan = [(speed, kind) for speed in ((150.0, 100.0) if few else (190.0, 140.0, 110.0, 90.0)) for kind in kinds]
    axes = ("longitudinal", "lateral") if six else ("longitudinal",)
    folder = tmp_path_factory.mktemp("fighter")
    records, card = polynomial_fighter(folder, plane, plan, rng, 8.0 if few else 10.0, *axes)
    return diagnose(records, card, seed=seed, gains_wanted=False, process_noise=False)


NO_FORM = pytest.mark.xfail(strict=True, reason="CL is found over alpha and q, without a form")


@pytest.mark.verify
@pytest.mark.parametrize("nonlinear", range(4), indirect=True)
def test_no_cause_is_sure_that_a_form_of_a_nonlinear_fighter_explains_as_well(nonlinear):
    assert not [c.name for c in nonlinear.causes if c.sure and c.name not in FORMS and not c.ambiguous_with]
    assert {one.coefficient for one in (*nonlinear.terms, *nonlinear.unknown)} >= {"CL", "Cm"}


@pytest.mark.verify
@pytest.mark.parametrize("nonlinear", [0, 1, 2, pytest.param(3, marks=NO_FORM)], indirect=True)
def test_lift_and_pitching_moment_of_a_nonlinear_fighter_have_a_form(nonlinear):
    assert {term.coefficient for term in nonlinear.terms} >= {"CL", "Cm"}
