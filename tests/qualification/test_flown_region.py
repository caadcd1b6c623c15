"""Distance from a convex hull against closed forms: boxes, simplices, hulls without volume."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import linprog

from bayes_aero.qualification.region import Region, nearest


def box(k):
    """The corners of [-1, 1]^k."""
    return np.array(list(itertools.product((-1.0, 1.0), repeat=k)))


@pytest.mark.parametrize("k", [1, 2, 4, 6])
def test_the_nearest_point_of_a_box_is_the_clipped_sample(k):
    rng = np.random.default_rng(0)
    for sample in 3.0 * rng.standard_normal((20, k)):
        assert nearest(box(k), sample) == pytest.approx(np.clip(sample, -1.0, 1.0), abs=1e-9)


@pytest.mark.parametrize("k", [2, 3, 6])
def test_the_nearest_point_of_a_simplex(k):
    """Of the standard simplex, corners e_i, to the origin: all components 1/k, distance 1/sqrt(k)."""
    found = nearest(np.eye(k), np.zeros(k))
    assert found == pytest.approx(np.full(k, 1.0 / k), abs=1e-9)
    assert np.linalg.norm(found) == pytest.approx(1.0 / np.sqrt(k), rel=1e-9)


def test_a_hull_without_volume():
    """A segment in the plane, a single point, and a far sample."""
    assert nearest(np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([1.0, 0.0])) == pytest.approx([0.5, 0.5])
    assert nearest(np.array([[2.0, 3.0]]), np.array([-1.0, 5.0])) == pytest.approx([2.0, 3.0])
    assert nearest(box(3), np.array([1e3, 0.5, -1e3])) == pytest.approx([1.0, 0.5, -1.0], abs=1e-6)


def test_inside_agrees_with_linear_programming():
    """A sample is inside if some convex combination of the points is the sample."""
    rng = np.random.default_rng(0)
    points = rng.standard_normal((60, 4))
    for sample in 1.2 * rng.standard_normal((40, 4)):
        weights = linprog(np.zeros(60), A_eq=np.vstack([points.T, np.ones(60)]), b_eq=np.append(sample, 1.0))
        distance = np.linalg.norm(nearest(points, sample) - sample)
        assert (distance < 1e-7) == (weights.status == 0)


def channels(**given):
    return {name: np.asarray(x, float) for name, x in given.items()}


def test_a_region_tells_share_distance_time_and_channels():
    """Flown: alpha 0 to 0.2, Mach 0.2 to 0.4, q -0.1 to 0.1. A ramp of alpha leaves it at 0.2 and ends at 0.4."""
    alpha, mach, q = box(3).T
    region = Region.of(channels(alpha=0.1 + 0.1 * alpha, mach=0.3 + 0.1 * mach, q=0.1 * q, elevator=q))
    assert region.channels == ("alpha", "mach", "q")
    n = 101
    ramp = channels(alpha=np.linspace(0.0, 0.4, n), mach=np.full(n, 0.3), q=np.zeros(n))
    found = region.outside("ramp", "recorded", 0.1 * np.arange(n), ramp)
    assert found.distance == pytest.approx(2.0)  # 0.2 rad beyond, of half a range of 0.1 rad
    assert found.time == pytest.approx(10.0)
    assert found.excess == pytest.approx({"alpha": 0.2, "mach": 0.0, "q": 0.0}, abs=1e-9)
    assert found.share == pytest.approx(np.mean(ramp["alpha"] > 0.21), abs=1e-9)  # beyond a tenth of the scale
    within = channels(alpha=np.full(n, 0.15), mach=np.full(n, 0.25), q=np.full(n, 0.05))
    assert region.outside("within", "recorded", 0.1 * np.arange(n), within) is None


def test_a_channel_that_did_not_move_has_a_scale_of_its_own():
    """Sideslip was always zero: two degrees of it are two least scales of a degree outside."""
    region = Region.of(channels(alpha=[0.0, 0.2], beta=[0.0, 0.0], airspeed=[80.0, 100.0]))
    assert region.channels == ("alpha", "beta", "airspeed")
    slipping = channels(alpha=[0.1], beta=[np.radians(2.0)], airspeed=[90.0])
    assert region.outside("slip", "recorded", np.zeros(1), slipping).distance == pytest.approx(2.0)
