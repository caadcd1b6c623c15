"""A linear model flown into the stall: diagnosis finds the separation of the flow and what depends on it."""

import numpy as np
import pytest
import six_axes
from stranger_six import Fighter, fly

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.flight.card.card import read_card
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


@pytest.mark.recovery
def test_a_wrong_form_of_the_coefficients_is_no_stall_and_no_camber(tmp_path):
    """A fighter of polynomials, by a simulator that shares no code, from 2 to 24 deg: what is found are forms.

    With the linear card `drag_offset` and `flow_separation` explain most of what is left. Neither is there. CZq is
    -30 per q c/2V, so lift by pitch rate is 15 qhat, whether it is called a term or by its name. One seed was flown;
    that `pitch_rate_lift` may be named was allowed after that run.
    """
    plane, rng, records = Fighter(), np.random.default_rng([1, 54]), []
    for speed in (190.0, 120.0, 90.0, 75.0):
        for _ in range(2):
            flight = fly(plane, "elevator", rng, seconds=10.0, V=speed)
            records.append(six_axes.record(f"m{len(records)}_{speed:.0f}", flight, rng))
    path = tmp_path / "card.toml"
    path.write_text(six_axes.card_text(plane, six_axes.LONGITUDINAL, ("longitudinal",)), encoding="utf-8")
    found = diagnose(records, read_card(str(path)), seed=1, gains_wanted=False, process_noise=False)
    assert {c.name for c in found.causes} <= {"pitch_rate_lift"}
    assert {term.coefficient for term in found.terms} == {"CL", "CD", "Cm"}
    assert {channel for term in found.terms for channel in term.term.channels} <= {"alpha", "q", "airspeed", "elevator"}
    sizes = [term.size for term in found.terms if (term.coefficient, term.term.name) == ("CL", "qhat")]
    sizes += [(c.parameters["CLq"].mean, c.parameters["CLq"].sd) for c in found.causes]
    ((mean, sd),) = sizes
    assert abs(mean - 15.0) < 4.0 * sd
