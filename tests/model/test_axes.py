"""Which effects a model of one axis has, proposes and computes, and in which reference lengths its defaults stand."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.diagnosis.candidate_set import CandidateModel, candidate_model
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.axes import Axis
from bayes_aero.flight.channel import STANDARD_CHANNELS
from bayes_aero.flight.record import FlightRecord
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.physics.coefficient_names import LATERAL, NAMES

BOTH = tuple(Axis)
LONGITUDINAL_CANDIDATES = """
    accel_x_bias accel_y_bias accel_y_scale accel_z_bias airspeed_bias airspeed_scale alpha_bias alpha_delay
    alpha_dot_lift alpha_dot_moment alpha_scale alpha_squared_moment altitude_scale bank_angle_bias bank_angle_scale
    canard_drag canard_lift canard_moment cg_shift density_scale dlc_lift dlc_moment drag_offset elevator_delay
    elevator_drag elevator_lift elevator_scale flap_drag flap_lift flap_moment inertia_scale mach_drag mach_moment
    mass_scale pitch_attitude_bias pitch_rate_bias pitch_rate_lift pitch_rate_scale pitot_pressure_bias roll_rate_bias
    roll_rate_scale rudder_moment separated_alpha_moment separated_damping separated_elevator separated_induced_drag
    separation_hysteresis separation_lag sideslip_bias sideslip_drag sideslip_lift sideslip_moment sideslip_scale
    spoiler_drag spoiler_lift spoiler_moment stabilizer_trim thrust_lag thrust_lift thrust_moment thrust_scale
    vane_position vertical_wind yaw_rate_bias yaw_rate_scale
""".split()  # noqa: SIM905
"""What the published ATTAS model lacks of the catalogue, where every channel was recorded and moves."""


def everything_recorded() -> FlightRecord:
    """A record that has every channel, none at rest or mere noise."""
    rng, time = np.random.default_rng(0), np.arange(200) * 0.04
    names = [name for name in STANDARD_CHANNELS if name != "time"]
    waves = {name: np.sin(rng.uniform(1.0, 4.0) * time + rng.uniform(0.0, 6.0)) for name in names}
    around = {"airspeed": 80.0, "density": 1.0, "thrust": 9e3, "az": -9.8, "mach": 0.3, "altitude": 5e3}
    channels = {name: around[name] + 0.02 * x if name in around else 0.14 * x for name, x in waves.items()}
    return FlightRecord.from_arrays("run", time, channels)


def candidates(card, axes) -> CandidateModel:
    """Those of a card's effects that act on `axes`."""
    names = [name for name in card.effects if CATALOGUE[name].acts_on(axes)]
    fixed = {k: v for k, v in card.fixed.items() if k in {p.name for n in names for p in CATALOGUE[n].parameters}}
    flights = join([everything_recorded()], replace(card, sums={}, constants={}))
    return candidate_model(Model.of(names, fixed, axes), flights)


def test_a_longitudinal_card_knows_no_lateral_effect(card):
    found = candidates(card, (Axis.LONGITUDINAL,))
    assert sorted(e.name for e in found.candidates) == LONGITUDINAL_CANDIDATES
    assert found.not_testable == {}
    lateral = {name for name, effect in CATALOGUE.items() if effect.axes == (Axis.LATERAL,)}
    assert {"roll_damping", "sideslip_yaw", "rudder_side_force"} <= lateral
    assert not lateral & {e.name for e in found.model.effects}


def test_a_card_of_both_axes_has_the_candidates_of_both(card):
    found = {e.name for e in candidates(card, BOTH).candidates}
    assert found >= {*LONGITUDINAL_CANDIDATES, "roll_damping", "aileron_yaw", "spoiler_roll", "side_force_offset"}


def test_a_lateral_card_lacks_what_adds_to_lift_drag_and_pitching_moment(card):
    found = candidates(card, (Axis.LATERAL,))
    assert found.model.coefficients == LATERAL
    names = {e.name for e in found.model.effects} | set(found.not_testable)
    assert {"roll_damping", "sideslip_bias", "mass_scale", "roll_rate_bias"} <= names
    assert not {"pitch_rate_lift", "kirchhoff_lift", "thrust_moment", "elevator_lift", "mach_drag"} & names


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
def test_what_adds_to_coefficients_of_one_axis_acts_on_it(effect):
    added = set(effect.example.increments)
    if effect.stage > Stage.AIRCRAFT and added & set(LATERAL):
        assert effect.axes == (BOTH if added & set(NAMES) else (Axis.LATERAL,))
    if effect.stage > Stage.AIRCRAFT and added and added <= {*NAMES, "CL_attached"}:
        assert effect.axes == (Axis.LONGITUDINAL,)


def test_a_model_refuses_an_effect_of_an_axis_that_it_lacks(card):
    with pytest.raises(InputError, match=r'effect roll_damping acts on Cl .* add "lateral" to the axes'):
        Model.of([*card.effects, "roll_damping"])
    with pytest.raises(InputError, match="effect pitch_damping acts on Cm of the longitudinal axis"):
        Model.of(["roll_damping", "pitch_damping"], axes=(Axis.LATERAL,))


TERMS = ["roll_damping", "sideslip_roll", "yaw_damping", "rudder_side_force", "pitch_damping"]


@pytest.mark.parametrize(("rate_length", "moment_length"), [(None, None), (21.5, None), (43.0, 10.75), (3.159, 3.159)])
def test_defaults_in_the_lengths_of_a_card_are_the_same_forces_and_moments(card, rate_length, moment_length):
    """Moments in N m of the defaults: b or b/2 or 2V is only how they are written."""
    signals = {"alpha": 0.1, "p": 0.2, "q": 0.1, "r": -0.1, "beta": 0.03, "rudder": 0.05, "airspeed": 80.0}
    signals = {name: jnp.asarray([x]) for name, x in signals.items()}

    def moments(aircraft):
        model = Model.from_card(replace(card, aircraft=aircraft, effects=tuple(TERMS), fixed={}, changes={}, axes=BOTH))
        values = {p.name: p.start for p in model.parameters} | {"CYdr": 0.2}
        known = model.flow(values, signals, aircraft)
        return [float(x[0]) for x in (known["CY"], known["Cl"] * aircraft.moment_length,
                                      known["Cn"] * aircraft.moment_length, known["Cm"])], model  # fmt: skip

    usual, before = moments(card.aircraft)
    other, after = moments(replace(card.aircraft, lateral_rate_length=rate_length, lateral_length=moment_length))
    assert all(abs(x) > 1e-4 for x in usual)
    np.testing.assert_allclose(other, usual, rtol=1e-12)
    changed = {p.name for p, q in zip(before.parameters, after.parameters, strict=True) if p.prior != q.prior}
    moment = {"Clp", "Clbe", "Cnr"} if moment_length else set()
    assert changed == moment | ({"Clp", "Cnr"} if rate_length else set())
