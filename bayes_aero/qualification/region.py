"""The flown region: the convex hull of flown samples, and how far another motion lies outside.

The nearest point of a hull to a sample is the point of least norm of the hull that is moved by the sample, and that is
a least-squares problem with weights that are not negative. It needs no facets, of which a hull in six dimensions has
very many, and holds for hulls without volume.

Source: Lawson and Hanson, *Solving Least Squares Problems*, 1974, ch. 23 (least distance programming).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from bayes_aero.qualification.result import Outside

CHANNELS = ("alpha", "beta", "mach", "p", "q", "r")
LEAST = {
    "alpha": math.radians(1.0), "beta": math.radians(1.0), "mach": 0.01, "airspeed": 3.0,
    "p": math.radians(1.0), "q": math.radians(1.0), "r": math.radians(1.0),
}  # fmt: skip
"""Least scale of a channel: a hull with little spread does not make every sample an extrapolation. Our choice."""
MOST_FLOWN, MOST_ASKED = 20_000, 200  # samples of the region, and of a motion that is compared with it
ROUNDING = 1e-6  # of the scale
NOTABLE = 0.1  # of the scale: a smaller distance is the noise of the samples that span the hull; our choice


def nearest(points: Float[np.ndarray, "n k"], sample: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """The point of the convex hull of `points` that is nearest to `sample`."""
    moved = (points - sample).T
    size = max(1.0, float(np.min(np.linalg.norm(moved, axis=0))))  # far samples, too, are solved to rounding
    weights, _ = nnls(np.vstack([moved / size, np.ones(moved.shape[1])]), np.append(np.zeros(len(moved)), 1.0))
    return sample + moved @ weights / weights.sum()


@dataclass(frozen=True)
class Region:
    """Flown samples (n, k) of channels, SI; distances are counted in `scale`, half of what was flown of a channel."""

    channels: tuple[str, ...]
    points: Float[np.ndarray, "n k"]
    scale: Float[np.ndarray, " k"]

    @classmethod
    def of(cls, flown: Mapping[str, Float[np.ndarray, " n"]]) -> Region:
        """The region of the channels (n,) that are of `CHANNELS`; airspeed where there is no Mach number."""
        names = tuple(
            n if n in flown or n != "mach" else "airspeed"
            for n in CHANNELS
            if n in flown or (n == "mach" and "airspeed" in flown)
        )
        if not names:
            return cls((), np.zeros((0, 0)), np.zeros(0))
        points = np.stack([np.asarray(flown[n], float) for n in names], axis=1)
        scale = np.maximum(0.5 * np.ptp(points, axis=0), [LEAST[n] for n in names])
        return cls(names, points, scale)

    def offsets(self, motion: Mapping[str, Float[np.ndarray, " m"]]) -> Float[np.ndarray, "m k"]:
        """From the nearest point of the hull to every sample, in units of `scale`; zero inside."""
        samples = np.stack([np.asarray(motion[n], float) for n in self.channels], axis=1) / self.scale
        points = np.unique(_extremes_kept(self.points, MOST_FLOWN) / self.scale, axis=0)
        found = np.array([sample - nearest(points, sample) for sample in samples])
        return np.where(np.linalg.norm(found, axis=1, keepdims=True) > ROUNDING, found, 0.0)

    def outside(
        self, manoeuvre: str, kind: str, time: Float[np.ndarray, " m"], motion: Mapping[str, Float[np.ndarray, " m"]]
    ) -> Outside | None:
        """How far a motion leaves the region, SI; None where it does not by more than `NOTABLE`."""
        kept = np.unique(np.linspace(0, len(time) - 1, min(len(time), MOST_ASKED)).astype(int))
        offsets = self.offsets({n: np.asarray(motion[n])[kept] for n in self.channels})
        distance = np.linalg.norm(offsets, axis=1)
        if distance.max() <= NOTABLE:
            return None
        worst = int(np.argmax(distance))
        excess = dict(zip(self.channels, map(float, offsets[worst] * self.scale), strict=True))
        share, when = float(np.mean(distance > NOTABLE)), float(time[kept[worst]] - time[0])
        return Outside(manoeuvre, kind, self.channels, share, float(distance[worst]), when, excess)


def _extremes_kept(points: Float[np.ndarray, "n k"], most: int) -> Float[np.ndarray, "m k"]:
    """Evenly thinned, with the extremes of every channel."""
    if len(points) <= most:
        return points
    kept = np.linspace(0, len(points) - 1, most).astype(int)
    return points[np.unique([*kept, *np.argmin(points, axis=0), *np.argmax(points, axis=0)])]
