"""Parameters and their priors: plain data, and the prior's log-density."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from bayes_aero.arrays import AnyArray
from bayes_aero.errors import InputError

FAMILIES = ("normal", "lognormal", "halfnormal", "uniform")


class Role(StrEnum):
    """What a parameter of any name is to the simulation and to the fit."""

    BREAK_ANGLE = "break angle"  # rad, angle of attack at which the static separation point is half way
    ABRUPTNESS = "abruptness"  # of the stall: how fast the static separation point moves there
    LAG = "lag"  # time constant with which the separation point follows its static value, chords travelled; neutral 0
    DELAY = "delay"  # s, of the recorded channel that the effect names first; neutral 0


class Length(StrEnum):
    """A reference length in which a nondimensional parameter is stated; a card may state another."""

    RATE = "c/V"  # it multiplies q c/V
    LATERAL_RATE = "b/2V"  # it multiplies p b/2V or r b/2V
    LATERAL_MOMENT = "b"  # rolling and yawing moment over the span


@dataclass(frozen=True)
class Lengths:
    """How often a card's reference length goes into the usual one; `span`: over that of the catalogue's transport."""

    rate: float = 1.0
    lateral_rate: float = 1.0
    lateral_moment: float = 1.0
    span: float = 1.0

    def times(self, parameter: Parameter) -> float:
        """What a parameter for the usual lengths is multiplied by."""
        return math.prod(getattr(self, length.name.lower()) for length in parameter.lengths)


USUAL = Lengths()
USUALLY = {Length.RATE: "q c/V", Length.LATERAL_RATE: "b/2V", Length.LATERAL_MOMENT: "moments over the span"}


@dataclass(frozen=True)
class Prior:
    """One parameter's prior distribution.

    `normal`: mean `location`, standard deviation `scale`. `lognormal`: median `location` (> 0), standard deviation
    `scale` of the logarithm. `halfnormal`: scale `scale` above `location`. `uniform`: from `location` to
    `location + scale`. `source` states the origin of the numbers, or "our choice". `by_card`: a card states it;
    otherwise it is the default.
    """

    family: str
    location: float
    scale: float
    source: str = "our choice"
    by_card: bool = False

    def __post_init__(self) -> None:
        if self.family not in FAMILIES:
            raise InputError(f"a prior has the family {self.family!r}; use one of {', '.join(FAMILIES)}")
        if not (math.isfinite(self.scale) and self.scale > 0.0 and math.isfinite(self.location)):
            numbers = f"location {self.location} and scale {self.scale}"
            raise InputError(f"a {self.family} prior has {numbers}; both must be finite and the scale positive")
        if self.family == "lognormal" and self.location <= 0.0:
            raise InputError(f"a lognormal prior has the median {self.location}; it must be positive")

    def log_density(self, x: Float[AnyArray, ""]) -> Float[AnyArray, ""]:
        """Natural logarithm of the prior density at `x`, in the parameter's own unit."""
        import jax.numpy as jnp
        import jax.scipy.stats as stats

        if self.family == "uniform":
            return stats.uniform.logpdf(x, self.location, self.scale)
        if self.family in ("normal", "halfnormal"):
            density = stats.norm.logpdf(x, self.location, self.scale)
            above = jnp.where(x >= self.location, density + jnp.log(2.0), -jnp.inf)
            return density if self.family == "normal" else above
        safe = jnp.where(x > 0.0, x, 1.0)
        density = stats.norm.logpdf(jnp.log(safe), math.log(self.location), self.scale) - jnp.log(safe)
        return jnp.where(x > 0.0, density, -jnp.inf)

    @property
    def normal(self) -> tuple[float, float]:
        """Mean and standard deviation of the normal distribution that replaces it in a linear fit."""
        if self.family == "lognormal":
            return self.location, self.location * self.scale
        if self.family == "uniform":
            return self.location + self.scale / 2.0, self.scale
        return self.location, self.scale

    @property
    def text(self) -> str:
        """As people read it: mean and deviation, median and factor, or the ends."""
        first, scale, last = (f"{x:.4g}" for x in (self.location, self.scale, self.location + self.scale))
        away = {"normal": f"± {scale}", "lognormal": f"× e^±{scale}", "halfnormal": f"+ |{scale}|"}
        return f"{first} {away.get(self.family, f'to {last}')}"

    def sample(self, rng: np.random.Generator, size: int) -> np.ndarray:
        """`size` independent draws, shape (size,)."""
        if self.family == "uniform":
            return rng.uniform(self.location, self.location + self.scale, size)
        away = rng.normal(0.0, self.scale, size)
        if self.family == "lognormal":
            return self.location * np.exp(away)
        return self.location + (away if self.family == "normal" else np.abs(away))


@dataclass(frozen=True)
class Sign:
    """The `side` of zero, +1 or -1, on which a parameter lies in the axes of ISO 1151.

    An estimate on the other side puts the sign of `channel` in doubt; `otherwise` says what it would mean.
    """

    side: int
    channel: str
    otherwise: str


@dataclass(frozen=True)
class Limits:
    """Lowest and highest value that an aircraft can have, and why there is none beyond."""

    low: float
    high: float
    reason: str


@dataclass(frozen=True)
class Parameter:
    """One scalar of a model, in SI units and radians.

    `neutral` is the value at which the effect that owns the parameter is absent. Estimation begins at `start`.
    `bounds` are (lower, upper), infinite where there is none. `lengths`: reference lengths in which its start, bounds
    and prior are stated, and on which they depend (see `per_length`). `role`: see `Role`. `sign` and `limits` are None
    where an estimate may have either sign or any size. Tables list parameters by `place` (drag from 10, lift from 20,
    pitching moment from 30, separation from 40, side force from 50, rolling moment from 60, yawing moment from 70),
    those without one behind. `knee`: how far above its lower bound the coordinate of samplers turns from the logarithm
    to the parameter itself; infinite: nowhere.
    """

    name: str
    unit: str
    neutral: float
    start: float
    description: str
    prior: Prior
    bounds: tuple[float, float] = field(default=(-math.inf, math.inf))
    lengths: tuple[Length, ...] = ()
    role: Role | None = None
    sign: Sign | None = None
    limits: Limits | None = None
    place: int | None = None
    knee: float = math.inf

    def __post_init__(self) -> None:
        lower, upper = self.bounds
        if not lower < upper:
            raise InputError(f"parameter {self.name} has bounds {lower} to {upper}; the lower must be smaller")
        if not (math.isfinite(self.start) and lower <= self.start <= upper):
            raise InputError(f"parameter {self.name} starts at {self.start}, outside its bounds {lower} to {upper}")

    def away(self, value: float, sd: float) -> tuple[float, float]:
        """How far a value is from neutral, and its deviation: of the reciprocals where neutral is at infinity."""
        return (value - self.neutral, sd) if math.isfinite(self.neutral) else (1.0 / value, sd / value**2)

    def changed(self, **changes: object) -> Parameter:
        """A copy with some fields replaced, as a card does."""
        return replace(self, **changes)  # type: ignore[arg-type]


def per_length(parameter: Parameter, card: Lengths) -> Parameter:
    """A parameter in the reference lengths of a card."""
    times = card.times(parameter)
    if times == 1.0:
        return parameter
    prior, limits, text = parameter.prior, parameter.limits, parameter.description
    for length, written in ((Length.LATERAL_RATE, "b/2V"), (Length.RATE, "c/V")):
        if length in parameter.lengths:
            text = text.replace(written, f"l/V, l the card's {length.name.lower()}_length")
    usual = " and ".join(USUALLY[length] for length in parameter.lengths)
    return replace(
        parameter,
        start=times * parameter.start,
        bounds=(times * parameter.bounds[0], times * parameter.bounds[1]),
        limits=limits and replace(limits, low=times * limits.low, high=times * limits.high),
        description=text,
        prior=replace(
            prior,
            location=times * prior.location,
            scale=prior.scale if prior.family == "lognormal" else times * prior.scale,
            source=f"{prior.source}; for {usual}, here times {times:.4g}",
        ),
    )


def departure(value: float, neutral: float) -> float:
    """How far a parameter is from neutral along the tangent at its value; of its reciprocal where that is infinite."""
    return value - neutral if math.isfinite(neutral) else -value


def to_unbounded(parameter: Parameter, x: Float[AnyArray, "*shape"]) -> Float[AnyArray, "*shape"]:
    """Map the open interval of `parameter.bounds` onto the real line (identity, log or logit; see `knee`)."""
    import jax.numpy as jnp

    lower, upper = parameter.bounds
    if math.isfinite(lower) and parameter.knee < upper - lower:
        distance = (x - lower) / parameter.knee
        if math.isfinite(upper):
            distance = -jnp.log1p((lower - x) / (upper - lower)) * (upper - lower) / parameter.knee
        return distance + jnp.log(-jnp.expm1(-distance))
    if math.isinf(lower) and math.isinf(upper):
        return x
    if math.isinf(upper):
        return jnp.log(x - lower)
    if math.isinf(lower):
        return -jnp.log(upper - x)
    return jnp.log(x - lower) - jnp.log(upper - x)


def from_unbounded(
    parameter: Parameter, u: Float[AnyArray, "*shape"]
) -> tuple[Float[AnyArray, "*shape"], Float[AnyArray, "*shape"]]:
    """The inverse of `to_unbounded`, and log |dx/du|, which the density of `u` carries."""
    import jax.numpy as jnp

    lower, upper = parameter.bounds
    if math.isfinite(lower) and parameter.knee < upper - lower:
        distance = parameter.knee * jnp.logaddexp(0.0, u)
        log_slope = math.log(parameter.knee) - jnp.logaddexp(0.0, -u)
        if math.isinf(upper):
            return lower + distance, log_slope
        share = distance / (upper - lower)
        return lower - (upper - lower) * jnp.expm1(-share), log_slope - share
    if math.isinf(lower) and math.isinf(upper):
        return u, jnp.zeros_like(u)
    if math.isinf(upper):
        return lower + jnp.exp(u), u
    if math.isinf(lower):
        return upper - jnp.exp(-u), -u
    share = 1.0 / (1.0 + jnp.exp(-u))
    log_slope = -jnp.logaddexp(0.0, -u) - jnp.logaddexp(0.0, u) + math.log(upper - lower)
    return lower + (upper - lower) * share, log_slope
