"""Sensitivities of simulated windows to where they begin, against differences."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from gusty_flight import TRUTH, gusty_flight

from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.flight.card.card import read_card
from bayes_aero.model.joined_channels import join
from bayes_aero.model.model import Model
from bayes_aero.residuals.output_error import OutputError

STEP = 1e-5


def test_offsets_are_central_differences_along_initial_states():
    """Two windows, each with an initial state of its own, of which the other knows nothing."""
    card = read_card("hfb320")
    model = Model.from_card(card)
    flights = join([gusty_flight(5, seconds=20.0)], card, FLIGHT)
    responses = OutputError.of(flights, aircraft_dynamics(model, flights))
    theta = np.array([TRUTH.get(p.name, p.start) for p in model.free])
    offsets, states = responses.offsets(theta, responses.outputs), responses.windows.dynamics.start
    window = np.asarray(responses.stretch)
    assert set(window) == {0, 1}
    residual = eqx.filter_jit(lambda shared: responses.residual(jnp.asarray(theta), shared))
    for k in range(len(states)):
        step = STEP * (np.arange(len(states)) == k)
        ahead, behind = (np.asarray(residual(jnp.asarray(sign * step))) for sign in (1, -1))
        slope = (behind - ahead) / (2.0 * STEP)
        for w in (0, 1):
            own = offsets[:, :, w * len(states) + k]
            np.testing.assert_allclose(own[window == w], slope[window == w], atol=1e-7 * np.abs(slope).max())
            assert not own[window != w].any()
