"""Highest steady lift and the angle of it: closed forms, an independent search, and what lies beyond the record."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.inference.stall import maxima, stall_of
from bayes_aero.model.model import Model
from bayes_aero.parameter import Parameter, Prior

FLOWN = {
    "alpha": np.deg2rad(np.linspace(2.0, 22.0, 500)),
    "alpha_dot": np.deg2rad(5.0) * np.sin(np.linspace(0.0, 20.0, 500)),
    "airspeed": np.linspace(110.0, 60.0, 500),
    "q": np.full(500, 0.1),
}


def _parabola():
    """CL = 2 b alpha - c alpha^2: its maximum is b^2/c, at b/c."""
    parameters = tuple(Parameter(n, "1", 0.0, 1.0, "of a test", Prior("normal", 0.0, 1.0)) for n in ("b", "c"))
    return Effect(
        "parabola", Kind.AERODYNAMICS, Stage.TOTAL, "test", parameters, ("alpha",),
        lambda v, s, *_: {"CL": 2.0 * v["b"] * s["alpha"] - v["c"] * s["alpha"] ** 2},
        Example({}, {}, {}, ""), "",
    )  # fmt: skip


def test_a_parabola_has_its_known_maximum(card):
    rng = np.random.default_rng(0)
    c = rng.uniform(20.0, 30.0, 300)
    b = c * rng.uniform(0.2, 0.3, 300)
    found = stall_of(Model.of([_parabola()]), np.stack([b, c], axis=1), FLOWN, card.aircraft)
    low, median, high = np.quantile(b**2 / c, [0.025, 0.5, 0.975])
    assert (found.CL_max.low, found.CL_max.median, found.CL_max.high) == pytest.approx((low, median, high), rel=1e-9)
    low, median, high = np.quantile(b / c, [0.025, 0.5, 0.975])
    assert (found.alpha_max.low, found.alpha_max.median, found.alpha_max.high) == pytest.approx((low, median, high))
    assert found.at_edge == 0.0
    assert found.seen


def test_kirchhoffs_stall_by_another_search(card, model):
    """CL written out by hand and searched by Brent's method: no code shared with the package."""
    value = {"CL0": 0.2, "CLa": 3.0, "CLaM": 4.0, "a1": 25.0, "alpha_star": 0.3}
    theta = np.array([value.get(p.name, p.start) for p in model.free])
    signals = {**FLOWN, "mach": np.full(500, 0.3), "elevator": np.zeros(500)}
    found = stall_of(model, theta[None], signals, card.aircraft)

    def lift(alpha):
        X = 0.5 * (1.0 - np.tanh(25.0 * (alpha - 0.3)))
        return 0.2 + (3.0 * ((1.0 + np.sqrt(X)) / 2.0) ** 2 + 4.0 * 0.3) * alpha

    best = minimize_scalar(lambda a: -lift(a), bounds=(0.1, 0.34), method="bounded", options={"xatol": 1e-10})
    steady = lift(found.alpha)
    assert found.CL[1] == pytest.approx(steady, abs=1e-12)
    assert found.CL_max.median == pytest.approx(-best.fun, abs=2e-6)
    assert found.alpha_max.median == pytest.approx(best.x, abs=2e-4)
    falling, still, rising = found.X[:, 1]
    assert np.all(falling <= still)  # late reattachment: less attached flow at the same angle
    assert np.array_equal(rising, still)  # one-sided as published
    assert np.any(falling < still - 0.01)


def test_a_maximum_beyond_the_record_is_flagged(card):
    draws = np.array([[0.5 * c, c] for c in (20.0, 25.0)])  # at 0.5 rad, 29 deg, where nobody flew
    found = stall_of(Model.of([_parabola()]), draws, FLOWN, card.aircraft)
    assert found.at_edge == 1.0
    assert not found.seen
    assert found.alpha_max.high == pytest.approx(np.deg2rad(22.0))


def test_maxima_between_points_and_at_edges():
    x = np.linspace(0.0, 1.0, 11)
    rows = np.stack([1.0 - (x - 0.33) ** 2, x, -x])
    peak, place, edge = maxima(x, rows)
    assert peak == pytest.approx([1.0, 1.0, 0.0])
    assert place == pytest.approx([0.33, 1.0, 0.0])
    assert edge.tolist() == [False, True, True]
