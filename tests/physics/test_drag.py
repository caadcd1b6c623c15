"""The drag of the stalled wing against the textbook's polar, written out by hand."""

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.model.model import Model

EFFECTS = (
    "attached_lift", "flow_separation", "kirchhoff_lift",
    "profile_drag", "induced_drag", "separated_drag", "separated_induced_drag",
)  # fmt: skip
VALUES = {"CL0": 0.3, "CLa": 5.2, "a1": 22.0, "alpha_star": 0.27, "CD0": 0.03, "e": 0.78, "CDX": 0.06}


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_drag_is_that_of_the_attached_lift_or_of_the_lift_that_is_left(card, share):
    alpha = np.linspace(-0.05, 0.4, 60)
    model = Model.of(EFFECTS)
    signals = {name: jnp.zeros(60) for name in model.channels} | {"alpha": jnp.asarray(alpha)}
    signals |= {"airspeed": jnp.full(60, 60.0), "dt": jnp.full(60, 0.05)}
    signals |= {"alpha_dot": jnp.zeros(60), "start": jnp.arange(60) == 0}
    values = {name: jnp.asarray(x) for name, x in (VALUES | {"induced_share": share}).items()}
    known = model.flow(values, signals, card.aircraft)
    X = 0.5 * (1.0 - np.tanh(22.0 * (alpha - 0.27)))
    attached = 0.3 + 5.2 * alpha
    CL = 0.3 + 5.2 * ((1.0 + np.sqrt(X)) / 2.0) ** 2 * alpha
    square = (CL if share else attached) ** 2
    CD = 0.03 + square / (np.pi * 0.78 * card.aircraft.aspect_ratio) + 0.06 * (1.0 - X)
    np.testing.assert_allclose(known["CL"], CL, rtol=1e-6)
    np.testing.assert_allclose(known["CD"], CD, rtol=1e-6)
    assert np.ptp(CL - attached) > 0.5  # the two polars differ here
