"""Filter error: innovations of whole manoeuvres, the errors of one-step predictions by a Kalman filter.

The gains are those of an extended Kalman filter at one set of parameters; they are held while the parameters vary. The
innovations of a correct model are white, also in turbulence. An effect that the model lacks correlates them with its
input. Source: Jategaonkar, *Flight Vehicle System Identification*, 2nd ed. 2015, ch. 5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from bayes_aero.dynamics.aircraft import POINTS
from bayes_aero.dynamics.flight import AircraftDynamics
from bayes_aero.dynamics.innovations import (
    Observed,
    Observer,
    StateDerivatives,
    linearise,
    observer_derivatives,
    observer_of,
    run_observer,
    state_derivatives,
)
from bayes_aero.dynamics.kalman import Filtered
from bayes_aero.dynamics.segments import SegmentTrajectories, prepare
from bayes_aero.residuals.output_error import OutputError

PART = 5.0  # s; our choice: some twenty neighbouring innovations and more, and a minute has a dozen parts


class FilterError(OutputError):
    """Whitened innovations, m samples.

    They are not averaged over blocks as outputs are. The sensitivity to a sensor error contains the noise of that
    sensor up to the sample before; a block mean would correlate it with the noise of the residual.
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
        """Innovations of a filtered record (`cut`) under extended dynamics, from the filter's parameters, noise and
        result.

        `dynamics` with more effects may lack states of the filter, such as gusts without intensity, and have two
        separation points where the filter has one, with which both move while the effects are neutral.
        """
        by = _observer(cut.nameless, jnp.asarray(theta), jnp.asarray(R), found)
        dynamics, states = dynamics.for_filter(), cut.dynamics.states
        own = [name if name in states or name not in POINTS else POINTS[0] for name in dynamics.states]
        rows = np.array([states.index(name) for name in own])
        by = Observer(by.gain[:, :, rows], by.whitening)
        cut, place = replace(cut, dynamics=dynamics), np.flatnonzero(cut.inside)
        return cls(flights=cut.flights, windows=cut, place=place, model=dynamics.model, by=by)

    @property
    def manoeuvre(self) -> Int[np.ndarray, " m"]:
        """Which manoeuvre each sample belongs to."""
        return self.flights.manoeuvre[self.windows.index.ravel()[self.place]]

    @property
    def seconds(self) -> float:
        """Sample time, s."""
        return float(np.median(self.windows.dt))

    def _mean(self, x: Float[Array, "w n ..."]) -> Float[Array, "m ..."]:
        return x.reshape(-1, *x.shape[2:])[self.place]

    @property
    def stretch(self) -> None:
        """None: innovations are stationary."""

    @property
    def averaged(self) -> int:
        """Each is of one sample."""
        return 1

    @property
    def jackknife_blocks(self) -> Int[np.ndarray, " m"]:
        """Parts of about `PART` s of every manoeuvre: innovations of different parts are uncorrelated."""
        manoeuvre, begin, found = self.manoeuvre, 0, np.zeros(len(self.place), int)
        for k in range(int(manoeuvre[-1]) + 1):
            own = np.flatnonzero(manoeuvre == k)
            count = max(round(len(own) * self.seconds / PART), 1)
            found[own] = begin + np.arange(len(own)) * count // len(own)
            begin += count
        return found

    def residual(self, theta: Any, shared: Any) -> Float[Array, "m c"]:  # noqa: ARG002
        """Whitened innovations at these parameters."""
        e = run_observer(self.flown, theta, self.by).innovation
        return self.whitened(theta, e[..., None])[..., 0]

    def _whitened(self, e: Float[Array, "w n c d"], scale: Float[Array, "w n c"]) -> Float[Array, "m c d"]:
        """Whitened, in units of the recorded channels."""
        return self._mean(jnp.einsum("wnij,wnjd->wnid", self.by.whitening, e / scale[..., None]))

    def slopes(
        self, theta: Float[np.ndarray, " k"], directions: Float[np.ndarray, "d k"]
    ) -> tuple[Float[np.ndarray, "m c"], Float[np.ndarray, "d m c"]]:
        """Residuals and minus their derivatives in these directions, along the path of the observer."""
        return self.slopes_at(theta)(directions)

    def slopes_at(self, theta: Float[np.ndarray, " k"]) -> Callable[[Float[np.ndarray, "d k"]], tuple]:
        """`slopes` as a function of the directions; the path and its derivatives by the state are computed once."""
        path, known = self.path_at(theta)

        def slopes(directions):
            residual, slope = _slopes(self.nameless, jnp.asarray(theta), path, known, jnp.asarray(directions))
            return np.asarray(residual), -np.moveaxis(np.asarray(slope), -1, 0)

        return slopes

    def path_at(self, theta: Float[np.ndarray, " k"]) -> tuple[Observed, StateDerivatives]:
        """The path of the observer at these parameters, and derivatives by the state along it."""
        return _path(self.nameless, jnp.asarray(theta))

    def whitened(self, theta: Any, e: Float[Array, "w n c d"]) -> Float[Array, "m c d"]:
        """Changes of the innovations as they change the residuals."""
        return self._whitened(e, prepare(self.flown, theta).scale)

    def offsets(self, theta: Float[np.ndarray, " k"], outputs: Sequence[str]) -> Float[np.ndarray, "m c o"]:  # noqa: ARG002
        """None: the filter estimates the initial state."""
        return np.zeros((len(self.place), len(outputs), 0))


_observer = eqx.filter_jit(observer_of)


@eqx.filter_jit
def _path(responses: FilterError, theta):
    path = run_observer(responses.flown, theta, responses.by)
    return path, state_derivatives(responses.flown, theta, path.before, path.after)


@eqx.filter_jit
def _slopes(responses: FilterError, theta, path, known, directions):
    lin = linearise(responses.flown, theta, path.before, path.after, directions, known)
    e = path.innovation[..., None]
    # A scale error changes the noise of the record with its signal; without this term it would fit noise.
    grown = e * lin.scale_drive / lin.scale[..., None]
    found = responses._whitened(
        jnp.concatenate([e, observer_derivatives(lin, responses.by) - grown], axis=-1), lin.scale
    )
    return found[..., 0], found[..., 1:]
