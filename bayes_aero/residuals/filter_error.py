"""Filter error: innovations of whole manoeuvres, what a filter did not foresee one sample ahead.

The gains are those of an extended Kalman filter at one set of parameters, and stay while parameters vary. Innovations
of a model without error are white, whatever the air does; an effect that it lacks makes them follow their cause.
Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.dynamics.filtering.innovations import Observer, observed, observer
from bayes_aero.dynamics.filtering.kalman import Filtered
from bayes_aero.dynamics.filtering.linearised import by_state, linearised, observer_slopes
from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.segments import SegmentTrajectories, prepared
from bayes_aero.residuals.output_error import OutputError


class FilterError(OutputError):
    """Whitened innovations, m samples.

    They are not averaged over blocks, as outputs are: the sensitivity to an error of a sensor holds that sensor's noise
    up to the sample before, and a mean would correlate it with the noise that it is to explain.
    """

    by: Observer

    @classmethod
    def after(
        cls,
        cut: SegmentTrajectories,
        theta: Float[np.ndarray, " k"],
        R: Float[np.ndarray, " c"],
        found: Filtered,
        dynamics: AircraftDynamics,
    ) -> FilterError:
        """Of a filter that followed segments `cut` at `theta` and `R` and gave `found`, under wider `dynamics`.

        These have the states of the filter, but perhaps not all: gusts of no intensity are none.
        """
        by = _observer(cut.nameless, jnp.asarray(theta), jnp.asarray(R), found)
        rows = np.array([cut.dynamics.states.index(name) for name in dynamics.states])
        by = Observer(by.gain[:, :, rows], by.whitening)
        cut, place = replace(cut, dynamics=dynamics), np.flatnonzero(cut.inside)
        return cls(flights=cut.flights, windows=cut, place=place, model=dynamics.model, by=by)

    @property
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        """Which manoeuvre each sample belongs to."""
        return self.flights.manoeuvre[self.windows.index.ravel()[self.place]]

    @property
    def seconds(self) -> float:
        """From sample to sample."""
        return float(np.median(self.windows.dt))

    def _mean(self, x: Float[Array, "w n ..."]) -> Float[Array, "m ..."]:
        return x.reshape(-1, *x.shape[2:])[self.place]

    @property
    def stretch(self) -> None:
        """None: innovations do not gather."""
        return

    def residual(self, theta: Any, shared: Any) -> Float[Array, "m c"]:  # noqa: ARG002
        """Whitened innovations at these parameters."""
        flown = self.flown
        e = observed(flown, theta, self.by).innovation
        return self._whitened(e[..., None], prepared(flown, theta).scale)[..., 0]

    def _whitened(self, e: Float[Array, "w n c d"], scale: Float[Array, "w n c"]) -> Float[Array, "m c d"]:
        """Referred to the record."""
        return self._mean(jnp.einsum("wnij,wnjd->wnid", self.by.whitening, e / scale[..., None]))

    def slopes(
        self, theta: Float[np.ndarray, " k"], directions: Float[np.ndarray, "d k"]
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "d m c"]]:
        """Residuals and minus their derivatives in these directions, along the path of the observer."""
        return self.sloped(theta)(directions)

    def sloped(self, theta: Float[np.ndarray, " k"]) -> Callable[[Float[np.ndarray, "d k"]], tuple]:
        """The path, and all that follows it alone, is found once."""
        nameless, at = self._nameless, jnp.asarray(theta)
        assert isinstance(nameless, FilterError)
        path, known = _path(nameless, at)

        def slopes(directions):
            residual, slope = _slopes(nameless, at, path, known, jnp.asarray(directions))
            return np.asarray(residual), -np.moveaxis(np.asarray(slope), -1, 0)

        return slopes

    def offsets(self, theta: Float[np.ndarray, " k"], outputs: Sequence[str]) -> Float[np.ndarray, "m c o"]:  # noqa: ARG002
        """None: the filter finds where a manoeuvre began."""
        return np.zeros((len(self.place), len(outputs), 0))


@eqx.filter_jit
def _observer(flown, theta, R, found):
    return observer(flown, theta, R, found)


@eqx.filter_jit
def _path(responses: FilterError, theta):
    path = observed(responses.flown, theta, responses.by)
    return path, by_state(responses.flown, theta, path.before, path.after)


@eqx.filter_jit
def _slopes(responses: FilterError, theta, path, known, directions):
    lin = linearised(responses.flown, theta, path.before, path.after, directions, known)
    e = path.innovation[..., None]
    # An error of scale makes the record's noise larger with its signal: without this term it would explain noise.
    grown = e * lin.scale_drive / lin.scale[..., None]
    found = responses._whitened(jnp.concatenate([e, observer_slopes(lin, responses.by) - grown], axis=-1), lin.scale)
    return found[..., 0], found[..., 1:]
