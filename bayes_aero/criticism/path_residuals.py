"""What the flight path leaves of a record, and of the same record with its channels disturbed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.flight.aircraft import NO_AIRCRAFT, Position
from bayes_aero.physics.filters import differentiate_joined
from bayes_aero.physics.flightpath import PATH_NEEDS, integral, path_rates

TOGETHER = 8  # disturbed records in one step of the compiled loop
RATES = ("p", "q", "r")


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
    n = len(next(iter(channels.values())))
    longer = _few_lengths(n)
    full = {name: jnp.asarray(_padded(np.asarray(channels[name]), longer)) for name in PATH_NEEDS}
    count = len(next(iter(added.values())))
    nothing = jnp.zeros((count, longer))
    more = {name: jnp.asarray(_padded(added[name], longer)) if name in added else nothing for name in PATH_NEEDS}
    x, y, z = (jnp.asarray(coordinate, float) for coordinate in accelerometer)
    found = _program(full, more, (x, y, z), jnp.asarray(dt), jnp.asarray(n - 1), tuple(outputs))
    return np.asarray(found)[:, :n]


def _few_lengths(n: int) -> int:
    """The next of 256, 384, 512, 768, ...: every length is another program to compile."""
    power = 1 << max(8, (n - 1).bit_length())
    return power * 3 // 4 if n <= power * 3 // 4 else power


def _padded(x: np.ndarray, n: int) -> np.ndarray:
    """The last sample goes on to length n."""
    return np.concatenate([x, np.repeat(x[..., -1:], n - x.shape[-1], axis=-1)], axis=-1)


@eqx.filter_jit
def _program(
    channels: Mapping[str, Array],
    added: Mapping[str, Array],
    accelerometer: Position,
    dt: Float[Array, ""],
    end: Int[Array, ""],
    outputs: tuple[str, ...],
) -> Float[Array, "r n c"]:
    n = channels["q"].shape[0]
    steps, first, last = jnp.full(n, dt), jnp.zeros(n, int), jnp.full(n, end)
    start = jnp.arange(n) == 0
    aircraft = replace(NO_AIRCRAFT, accelerometer=accelerometer)

    def one(extra: Mapping[str, Array]) -> Float[Array, "n c"]:
        s = {name: x + extra[name] for name, x in channels.items()}
        s |= {f"{name}_dot": differentiate_joined(s[name], steps, first, last) for name in RATES}
        rates = path_rates(s, aircraft)
        return jnp.stack([s[name] - integral(rates[name], steps, start, first) for name in outputs], axis=-1)

    return jax.lax.map(one, added, batch_size=TOGETHER)
