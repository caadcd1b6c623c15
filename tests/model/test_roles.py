"""Effects with names of their own that declare what their parameters are: they do what the catalogue's do."""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.plant import Inputs, Plant, Prescribed
from bayes_aero.dynamics.simulate import FlightState
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.simulate.demo import TRUTH, demo_records

OWN = {"a1": "sharpness", "alpha_star": "alpha_break", "tau1": "T_flow", "Cmde": "Cm_stick", "CLa": "lift_slope"}


def renamed(name):
    """An effect of the catalogue as a user would write it: other names, the same declarations."""
    effect = CATALOGUE[name]
    back = {OWN.get(p.name, p.name): p.name for p in effect.parameters}
    parameters = tuple(replace(p, name=OWN.get(p.name, p.name)) for p in effect.parameters)
    given = effect.increments

    def increments(v, s, a, known):
        return given({**v, **{old: v[new] for new, old in back.items()}}, s, a, known)

    sizes = {OWN.get(key, key): size for key, size in effect.sizes.items()}
    return replace(effect, name=f"own_{name}", parameters=parameters, increments=increments, sizes=sizes)


def models(card, *names):
    """The card's model, and the same with effects `names` in other words."""
    own = [renamed(e) if e in names else e for e in card.effects]
    return Model.of(card.effects), Model.of(own)


def values(**changes):
    """The demo's true values by both names."""
    true = TRUTH | changes
    return {name: jnp.asarray(x) for name, x in (true | {OWN[n]: true[n] for n in OWN}).items()}


def rates(model, card, v, X=0.4):
    """Rates of the state at one instant of a stall."""
    zero = jnp.asarray(0.0)
    plant = Plant(model, v, card.aircraft, (jnp.asarray(0.7), jnp.asarray(0.2), zero), zero)
    state = FlightState(*(jnp.asarray(x) for x in (80.0, 0.26, 0.2, 0.01, 5000.0, X)))
    inputs = Inputs(jnp.asarray(0.25), jnp.asarray(9e3), jnp.asarray(0.01), jnp.zeros(3))
    return plant.motion(state, inputs, Prescribed(*(zero for _ in Prescribed._fields)))[0]


def test_a_lag_of_any_name_is_flown(card):
    usual, own = models(card, "separation_lag")
    lagging = rates(usual, card, values(tau1=10.0))
    assert lagging.X != 0.0
    np.testing.assert_array_equal(rates(own, card, values(tau1=10.0)), lagging)
    flights = join(demo_records()[:1], card)
    steps = [aircraft_dynamics(m, flights).slowest_step(values(tau1=10.0), flights) for m in (usual, own)]
    assert steps[0] == steps[1] < np.inf


def test_a_lag_that_names_no_time_constant_cannot_be_flown(card):
    silent = renamed("separation_lag")
    silent = replace(silent, parameters=tuple(replace(p, role=None) for p in silent.parameters))
    model = Model.of([silent if e == "separation_lag" else e for e in card.effects])
    with pytest.raises(InputError, match="own_separation_lag is a lag .* none of its parameters has the role lag"):
        aircraft_dynamics(model, join(demo_records()[:1], card))
