"""Mean residuals over a channel: the channel that the residual follows comes first."""

import numpy as np
import pytest

from bayes_aero.diagnosis.selection.residuals import profiles

N = 600


@pytest.mark.parametrize("rest", [0, 200])
def test_the_channel_that_the_residual_follows_comes_first(rest):
    """Also of a simulation without noise that begins at rest: a bin of equal residuals has no deviation."""
    rng = np.random.default_rng(0)
    followed, other = rng.uniform(-1.0, 1.0, (2, N))
    followed[:rest], other[:rest] = -1.0, 0.0
    found = profiles(1e-5 * followed**2, {"other": other, "followed": followed}, 1.0)
    assert [p.channel for p in found] == ["followed", "other"]
    assert (np.min(found[0].deviation) == 0.0) == (rest > 0)
    np.testing.assert_allclose(found[0].mean, 1e-5 * found[0].centre ** 2, atol=2e-7)
