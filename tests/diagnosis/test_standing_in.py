"""When a function of a channel takes the place of a named cause."""

import numpy as np
import pytest

from bayes_aero.diagnosis.settings import DEFAULT
from bayes_aero.diagnosis.structure.unexplained import left_beside


def share(y, before, more):
    """Share of the variance that least squares leaves with `before` which `more` takes away."""

    def rest(columns):
        X = np.stack([*columns, np.ones(len(y))], axis=1)
        return float(np.sum((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2))

    return 1.0 - rest([*before, *more]) / rest(before)


@pytest.mark.parametrize(("proxy", "replaced"), [(1.0, False), (0.6, True), (0.3, True)])
def test_a_curve_replaces_a_proxy_and_not_the_line_that_is_true(proxy, replaced):
    """CD is a line in the elevator. A cubic of it explains as much alone, and nothing beside the line; beside a cause
    that follows the elevator by a correlation of 0.6 only, it explains what that leaves."""
    rng = np.random.default_rng(8)
    elevator, other, noise = rng.standard_normal((3, 800))
    CD = elevator + noise
    cause = proxy * elevator + np.sqrt(1.0 - proxy**2) * other
    curve = [elevator, elevator**2, elevator**3]
    alone, beside = share(CD, [], curve), share(CD, [cause], curve)
    assert alone == pytest.approx(0.5, abs=0.06)
    assert left_beside(alone, beside, DEFAULT) is replaced
