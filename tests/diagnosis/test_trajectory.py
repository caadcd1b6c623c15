"""The simulation before and after the extension, and a fit to trajectories alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.screening.selection_state import constants_of_manoeuvres
from bayes_aero.diagnosis.search.search_trajectories import in_windows
from bayes_aero.diagnosis.trajectories.trajectories import compare_trajectories
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.likelihood.output_error_result import OutputErrorStatus
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.model.model import Model
from bayes_aero.parameter import Parameter, Prior
from bayes_aero.simulate.demo import TRUTH
from bayes_aero.simulate.injection import Beyond, hidden_records

SEED = 4132
BANDS = {"airspeed": 1.5, "alpha": 0.035, "theta": 0.035}


@pytest.fixture(scope="module")
def flown(card):
    """A thrust line 0.6 m from where the card has it: found from coefficients, then flown."""
    records = hidden_records({"thrust_moment": {"thrust_arm": 0.6}}, seed=SEED, seconds=90.0)
    found = diagnose(records, card, gains_wanted=False)
    return found, compare_trajectories(despiked(join(records, card))[0], found, BANDS)


@pytest.mark.recovery
def test_the_simulation_gains_on_flights_it_was_not_fitted_to(flown):
    found, paths = flown
    assert "thrust_moment" in [c.name for c in found.causes], SEED
    assert {p.split for p in paths.paths} == {"fitted", "hold_out"}
    for manoeuvre in {p.manoeuvre for p in paths.paths}:
        before, after = (paths.path(manoeuvre, model, "hold_out") for model in ("card", "extended"))
        assert after.inside
        for name in ("airspeed", "theta"):
            assert after.errors[name].rms < 0.6 * before.errors[name].rms, (manoeuvre, name, SEED)
        for path in (before, after):
            for name, error in path.errors.items():
                residual = path.measured[name] - path.simulated[name]
                assert error.rms == pytest.approx(np.sqrt(np.mean(residual**2)))
                assert error.largest == pytest.approx(np.abs(residual).max())
                if name in BANDS:
                    assert error.within == pytest.approx(np.mean(np.abs(residual) <= BANDS[name]))
                    assert 0.0 <= error.probability <= 1.0


@pytest.mark.recovery
def test_trajectories_give_the_arm_back(flown):
    _, paths = flown
    near = max(0.06, 4.0 * paths.deviation["thrust_arm"])
    assert paths.extended.values["thrust_arm"] == pytest.approx(0.6, abs=near), SEED
    assert paths.card.values["thrust_arm"] == 0.0
    assert paths.variance_inflation >= 1.0


@pytest.mark.verify
def test_an_attitude_off_in_one_flight_is_fitted_and_leaves_the_arm_alone(flown, card):
    """The second flight's gyro stands off by a constant that the card allows for."""
    rng = np.random.default_rng(SEED)
    off = rng.uniform(0.006, 0.012) * rng.choice([-1.0, 1.0])
    found, plain = flown
    records = hidden_records({"thrust_moment": {"thrust_arm": 0.6}}, seed=SEED, seconds=90.0)
    flights = despiked(join(records, card))[0]
    theta = flights.channels["theta"] + np.where(np.asarray(flights.manoeuvre) == 1, off, 0.0)
    flights = replace(flights, channels={**flights.channels, "theta": theta})
    free = compare_trajectories(flights, found, {}, biases={"theta": Prior("normal", 0.0, 0.01)})
    apart = free.extended.values["bias_theta_2"] - free.extended.values["bias_theta_1"]
    assert apart == pytest.approx(off, abs=0.002), SEED
    near = max(0.06, 4.0 * free.deviation["thrust_arm"])
    assert free.extended.values["thrust_arm"] == pytest.approx(plain.extended.values["thrust_arm"], abs=near), SEED
    assert "bias_theta_2" not in plain.extended.values
    unseen = free.path(flights.names[1], "extended", "hold_out").errors["theta"]
    assert unseen.rms > 0.7 * abs(off)  # compared with the record as it is


def _without_accelerometers(record: FlightRecord) -> FlightRecord:
    kept = {name: x for name, x in record.channels.items() if name not in ("ax", "ay", "az")}
    return FlightRecord.from_arrays(record.name, record.time, kept)


@pytest.mark.recovery
def test_a_fit_that_strays_in_long_windows_is_begun_in_shorter_ones(card):
    """This flight, begun in windows of 10 s, ends at tau2 = -50 and a1 = 10, and leaves the envelope."""
    records = hidden_records({}, seed=8930, seconds=90.0, noise="ar1")
    flights, _ = despiked(join([_without_accelerometers(r) for r in records], card, FLIGHT))
    fit = in_windows(flights, aircraft_dynamics(Model.from_card(card), flights))
    assert fit.status is OutputErrorStatus.CONVERGED
    found = dict(zip(fit.names, fit.estimate, strict=True))
    assert found["alpha_star"] == pytest.approx(TRUTH["alpha_star"], abs=0.01)
    assert found["tau2"] == pytest.approx(TRUTH["tau2"], rel=0.3)
    assert found["a1"] == pytest.approx(TRUTH["a1"], rel=0.3)


def test_an_offset_of_a_coefficient_in_one_manoeuvre_is_its_constant_there():
    """Flown outputs to CL0, manoeuvre by manoeuvre: the constants add up to the model's own."""
    rng = np.random.default_rng(0)
    S, manoeuvre = rng.standard_normal((7, 2, 3)), np.array([0, 0, 0, 1, 1, 2, 2])
    full = CandidateModel(Model.of(["profile_drag", "attached_lift"]), (), (), {})
    assert full.model.names == ("CD0", "CL0", "CLa")
    found = constants_of_manoeuvres(full, manoeuvre, ("airspeed", "alpha"), S, "CL")
    np.testing.assert_allclose(found.sum(axis=2), S[:, :, 1])
    for k in range(3):
        np.testing.assert_array_equal(found[manoeuvre == k, :, k], S[manoeuvre == k, :, 1])
        assert not found[manoeuvre != k, :, k].any()


@pytest.mark.verify
@pytest.mark.parametrize("compared", ["trajectories", "innovations"])
def test_a_channel_that_labels_manoeuvres_explains_no_offset_of_simulated_flights(compared, card):
    """Lift 0.06 larger in the second flight, flown with flaps that hardly move: the offset is reported, and no flap."""
    made = Parameter("CLstep", "1", 0.0, 0.0, "more lift", Prior("normal", 0.0, 1.0), (-1.0, 1.0))
    step = Effect(
        "lift_step", Kind.AERODYNAMICS, Stage.ATTACHED, "More lift.", (made,), ("alpha",),
        lambda v, s, a, known: {"CL_attached": v["CLstep"] + 0.0 * s["alpha"]},  # noqa: ARG005
        Example({"CLstep": 0.1}, {"alpha": 0.1}, {"CL_attached": 0.1}, "by hand"), "by hand",
    )  # fmt: skip
    records = []
    for k, (more, flap) in enumerate(((0.0, 0.0), (0.06, 0.2))):
        beyond = Beyond((step,), lambda _, more=more: {"CLstep": more})
        flight = hidden_records({}, seed=77, noise="white", seconds=30.0, beyond=beyond)[k]
        channels = {n: np.asarray(x) for n, x in flight.channels.items() if n not in ("ax", "ay", "az")}
        channels["flap"] = flap + 0.004 * np.sin(0.3 * np.asarray(flight.time) + k)
        records.append(FlightRecord.from_arrays(flight.name, np.asarray(flight.time), channels, "simulated"))
    found = diagnose(records, card, gains_wanted=False, process_noise=compared == "innovations")
    assert found.compared == compared
    assert not found.causes
    (told,) = found.unknown
    assert (told.coefficient, told.channel) == ("CL", "manoeuvre")
    ((size, sd),) = told.offsets.values()
    assert size == pytest.approx(0.06, abs=3.0 * sd)
    assert "flap_lift" in told.rivals
