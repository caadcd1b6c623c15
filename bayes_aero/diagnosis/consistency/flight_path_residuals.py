"""What the flight path leaves of a record, and of the same record with its channels disturbed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_aero.flight.aircraft import NO_AIRCRAFT, Position
from bayes_aero.physics.filters import differentiate_joined
from bayes_aero.physics.flightpath import PATH_NEEDS, integral, path_rates
from bayes_aero.physics.kinematics import RATES

TOGETHER = 8  # disturbed records at a time, so that they stay in the processor's cache


def path_residuals(
    channels: Mapping[str, Float[np.ndarray, " n"]],
    added: Mapping[str, Float[np.ndarray, "r n"]],
    outputs: Sequence[str],
    accelerometer: Position,
    dt: float,
) -> Float[np.ndarray, "r n c"]:
    """Recorded minus integrated from the start, for each of r disturbances of the channels of one record.

    Args:
        channels: `PATH_NEEDS`, (n,) each, SI.
        added: what each disturbance adds to some of the channels, (r, n) each, SI.
        outputs: which of the flight path's outputs to form.
        accelerometer: its place from the centre of gravity, m.
        dt: sampling interval, s.

    Returns:
        (r, n, c) in the outputs' units.
    """
    n, count = len(channels["q"]), len(next(iter(added.values())))
    steps, start = np.full(n, dt), np.arange(n) == 0
    first, last = np.zeros(n, int), np.full(n, n - 1)
    aircraft = replace(NO_AIRCRAFT, accelerometer=accelerometer)
    found = np.empty((count, n, len(outputs)))
    for begin in range(0, count, TOGETHER):
        part = slice(begin, begin + TOGETHER)
        s = {name: channels[name] + added[name][part] if name in added else channels[name] for name in PATH_NEEDS}
        s |= {f"{name}_dot": differentiate_joined(s[name], steps, first, last) for name in RATES}
        rates = path_rates(s, aircraft)
        for c, name in enumerate(outputs):
            found[part, :, c] = s[name] - integral(rates[name], steps, start, first)
    return found
