"""Which columns of a linear regression are not zero: a posterior over their sets, for hundreds of collinear columns.

y = X_S b + e with e normal of deviation sigma and b of deviation sigma tau (the slab); all columns outside the set S
are zero (the spike). b is integrated out, so that a set costs a small determinant of inner products, whatever the
number of samples. A step draws a member of the set, or two, anew among all columns, and so exchanges it for any other.
A regularised horseshoe over the same columns has as many modes as there are collinear columns, between which NUTS
moves slowly.

Source: E. I. George and R. E. McCulloch, Approaches for Bayesian variable selection, Statistica Sinica 7, 1997 (the
integrated form); NUTS of NumPyro for sigma and tau.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import solve_triangular
from jaxtyping import Array, Bool, Float, Int
from numpyro.infer.hmc import HMCState, hmc

from bayes_aero.inference.posterior.assembly import TARGET_ESS, TARGET_RHAT, diagnose
from bayes_aero.inference.posterior.nuts import DIVERGENT_SHARE
from bayes_aero.inference.posterior.posterior import PosteriorStatus
from bayes_aero.inference.threads import cores

MOST = 4  # columns of a set
PADDED = 64  # columns are filled up to a multiple, so that problems of about one size share a compiled program
PASSES = ((10, 1500), (1, 2500))  # steps from one exchange of pairs to the next, and draws kept; the second if needed
HOT = 30.0  # variances of the noise with which the first set is drawn: by the middle of the warm-up it is the own one
SMALLEST = 1e-9  # of a column's squared length beside the members: copies of one column are not told apart
TWO_SIDED = (0.05, 0.95)  # inclusion probabilities between which a column's own chains are judged


class Columns(NamedTuple):
    """The regression by its inner products; every column has length 1.

    Attributes:
        gram: X'X, (p, p).
        right: X'y, (p,).
        square: y'y.
        count: samples n.
        log_odds: prior log odds of each column, (p,); -inf for one that is never in.
        spread: scale of the half-Cauchy prior of tau, in standard errors of a coefficient.
    """

    gram: Float[Array | np.ndarray, "p p"]
    right: Float[Array | np.ndarray, " p"]
    square: Float[Array, ""] | float
    count: Float[Array, ""] | float
    log_odds: Float[Array | np.ndarray, " p"]
    spread: Float[Array, ""] | float


@dataclass(frozen=True)
class SelectionDraws:
    """Draws of sets: `members` (chain, draw, MOST) are column numbers, -1 where a place is empty.

    `rhat` is the largest and `ess` the least of sigma, tau, the log density, the size of the set, and each column that
    is in it in 5 to 95 % of the draws.
    """

    members: Int[np.ndarray, "chain draw k"]
    noise: Float[np.ndarray, "chain draw"]
    slab: Float[np.ndarray, "chain draw"]
    status: PosteriorStatus
    rhat: float
    ess: float
    divergent: float

    def probability(self, *columns: int) -> float:
        """Posterior probability that at least one of these columns is in the set."""
        return float(np.isin(self.members, columns).any(axis=2).mean())

    def probabilities(self, count: int) -> Float[np.ndarray, " p"]:
        """Inclusion probability of each of `count` columns."""
        flat = self.members.reshape(-1)
        draws = self.members.shape[0] * self.members.shape[1]
        return np.bincount(flat[flat >= 0], minlength=count)[:count] / draws


def log_evidence(data: Columns, members: Int[Array, " k"], v: Float[Array, " 2"]) -> Float[Array, ""]:
    """Log likelihood of a set with b integrated out, with the priors of v = (log sigma, log tau)."""
    inside = members >= 0
    right, size, factor = jnp.where(inside, data.right[members], 0.0), jnp.sum(inside), _factor(data, members, v)
    explained = jnp.sum(solve_triangular(factor, right, lower=True) ** 2)
    log_determinant = 2.0 * jnp.sum(jnp.log(jnp.diag(factor))) + 2.0 * v[1] * size
    squares = (data.square - explained) * jnp.exp(-2.0 * v[0])
    return -data.count * v[0] - 0.5 * (log_determinant + squares) + log_prior(data, v)


def _factor(data: Columns, members: Int[Array, " k"], v: Float[Array, " 2"]) -> Float[Array, "k k"]:
    """Cholesky factor of the members' inner products with the slab; an empty place has length 1."""
    inside = members >= 0
    own = jnp.where(inside[:, None] & inside[None, :], data.gram[members[:, None], members[None, :]], 0.0)
    ridge = jnp.exp(-2.0 * v[1]) * jnp.eye(MOST)
    return jnp.linalg.cholesky(jnp.where(jnp.eye(MOST, dtype=bool) & ~inside[:, None], 1.0, own + ridge))


def log_prior(data: Columns, v: Float[Array, " 2"]) -> Float[Array, ""]:
    """Of v: sigma is about 1, tau half-Cauchy."""
    return -0.5 * v[0] ** 2 + v[1] - jnp.log1p(jnp.exp(2.0 * v[1]) / data.spread**2)


class _Given(NamedTuple):
    """The regression beside the members that stay: what they leave of X'y and of X'X with the slab, and how many places
    are free."""

    left: Float[Array, " p"]
    gram: Float[Array, "p p"]
    taken: Bool[Array, " p"]
    free: Int[Array, ""]


def _given(data: Columns, members: Int[Array, " k"], v: Float[Array, " 2"], *, whole: bool) -> _Given:
    """Unless `whole`, the diagonal of the inner products is all that is computed; it fills one row."""
    inside = members >= 0
    factor = _factor(data, members, v)
    rows = jnp.where(inside[:, None], data.gram[members], 0.0)
    both = jnp.concatenate([rows, jnp.where(inside, data.right[members], 0.0)[:, None]], axis=1)
    solved = solve_triangular(factor, both, lower=True)
    slab, size = jnp.exp(-2.0 * v[1]), len(data.right)
    if whole:
        gram = jnp.asarray(data.gram) + slab * jnp.eye(size) - solved[:, :-1].T @ solved[:, :-1]
    else:
        gram = (1.0 + slab - jnp.sum(solved[:, :-1] ** 2, axis=0))[None, :]
    taken = jnp.zeros(size).at[members].add(jnp.where(inside, 1.0, 0.0)) > 0.0
    return _Given(jnp.asarray(data.right) - solved[:, -1] @ solved[:, :-1], gram, taken, jnp.sum(~inside))


def _gain(left: Array, apart: Array, v: Float[Array, " 2"]) -> Array:
    """Log evidence that one column adds; `apart` is what the members leave of its length, slab included."""
    apart = jnp.maximum(apart, SMALLEST)
    return 0.5 * (left**2 / apart * jnp.exp(-2.0 * v[0]) - jnp.log(apart)) - v[1]


def _redrawn(
    data: Columns, members: Int[Array, " k"], v: Float[Array, " 2"], place: Int[Array, ""], key: Array
) -> Int[Array, " k"]:
    """The set with one place drawn anew among all columns and none, given the others.

    Places are numbered and sets are not, hence the division by the number of free places.
    """
    given = _given(data, members.at[place].set(-1), v, whole=False)
    gain = _gain(given.left, given.gram[0], v) + data.log_odds - jnp.log(given.free)
    drawn = jax.random.categorical(key, jnp.append(jnp.where(given.taken, -jnp.inf, gain), 0.0))
    return members.at[place].set(jnp.where(drawn < len(gain), drawn, -1))


def _redrawn_pair(data: Columns, members: Int[Array, " k"], v: Float[Array, " 2"], key: Array) -> Int[Array, " k"]:
    """The same of two places at once: two columns that describe together what one does are exchanged for it."""
    places, row, column = jax.random.split(key, 3)
    pair = jax.random.choice(places, MOST, (2,), replace=False)
    given = _given(data, members.at[pair].set(-1), v, whole=True)
    size, apart = len(given.left), jnp.maximum(jnp.diag(given.gram), SMALLEST)
    odds = jnp.where(given.taken, -jnp.inf, data.log_odds)
    one = _gain(given.left, apart, v) + odds - jnp.log(given.free)
    scaled, cross = given.left / jnp.sqrt(apart), given.gram / jnp.sqrt(apart[:, None] * apart[None, :])
    own = jnp.maximum(1.0 - cross**2, SMALLEST)
    squares = (scaled[:, None] ** 2 + scaled[None, :] ** 2 - 2.0 * cross * scaled[:, None] * scaled[None, :]) / own
    logs = jnp.log(apart)[:, None] + jnp.log(apart)[None, :] + jnp.log(own)
    both = 0.5 * (squares * jnp.exp(-2.0 * v[0]) - logs) - 2.0 * v[1] - jnp.log(given.free * (given.free - 1))
    both = jnp.where(jnp.eye(size, dtype=bool), -jnp.inf, both + odds[:, None] + odds[None, :])
    weight = jnp.pad(both, (0, 1)).at[:-1, -1].set(one).at[-1, :-1].set(one)
    first = jax.random.categorical(row, jax.nn.logsumexp(weight, axis=1))
    drawn = jnp.stack([first, jax.random.categorical(column, weight[first])])
    return members.at[pair].set(jnp.where(drawn < size, drawn, -1))


@cache
def _kernel(warmup: int):
    """NumPyro's functional NUTS with the set among the data, so that one program serves all problems of a size."""
    del warmup
    return hmc(potential_fn_gen=lambda data, members: lambda v: -log_evidence(data, members, v), algo="NUTS")


@eqx.filter_jit
def _chain(
    data: Columns, key: Array, pairs: Array, warmup: int, draws: int
) -> tuple[Int[Array, "draw k"], Float[Array, "draw 2"], dict[str, Array]]:
    """A chain from the empty set: in each step every place is drawn anew, then sigma and tau move by NUTS."""
    begin, advance = _kernel(warmup)
    members = jnp.full(MOST, -1)
    start, run = jax.random.split(key)
    v = jnp.array([0.0, 0.0]).at[1].set(jnp.log(data.spread)) + 0.1 * jax.random.normal(start, (2,))
    keys = jax.random.split(start, warmup + draws)
    state = begin(v, warmup, target_accept_prob=0.9, model_args=(data, members), rng_key=run)

    def step(carry: tuple[HMCState, Array], now: tuple[Array, Array]):
        state, members = carry
        first, *keys = jax.random.split(now[0], MOST + 1)
        v = state.z + jnp.array([0.5, 0.0]) * jnp.log(jnp.maximum(HOT * (1.0 - 2.0 * now[1] / warmup), 1.0))
        for place, own in enumerate(keys):
            members = _redrawn(data, members, v, jnp.array(place), own)
        members = jax.lax.cond(now[1] % pairs == 0, lambda m: _redrawn_pair(data, m, v, first), lambda m: m, members)
        energy, slope = jax.value_and_grad(lambda v: -log_evidence(data, members, v))(state.z)
        state = advance(state._replace(potential_energy=energy, z_grad=slope), (data, members))
        return (state, members), (members, state.z, -state.potential_energy, state.diverging)

    _, (drawn, z, density, diverging) = jax.lax.scan(step, (state, members), (keys, jnp.arange(len(keys))))
    return drawn[warmup:], z[warmup:], {"density": density[warmup:], "diverging": diverging[warmup:]}


def padded(data: Columns) -> Columns:
    """The problem with columns that are never in, up to a multiple of `PADDED`."""
    more = -len(data.right) % PADDED
    return data._replace(
        gram=jnp.pad(data.gram, ((0, more), (0, more))),
        right=jnp.pad(data.right, (0, more)),
        log_odds=jnp.pad(data.log_odds, (0, more), constant_values=-jnp.inf),
    )


def sample_sets(data: Columns, *, seed: int, chains: int = 4, warmup: int = 500) -> SelectionDraws:
    """Draw sets of columns; where the chains do not converge, once more with an exchange of pairs in every step.

    Exchanges of pairs cost the square of the number of columns, and few problems need many.

    Args:
        data: the regression; `padded` is applied here.
        seed: of all chains.
        chains: their number; each begins with a set of its own, drawn under ever less noise.
        warmup: steps of each that adapt NUTS and are left out.

    Returns:
        The draws, with the worst R-hat and effective sample size and the share of divergent steps.
    """
    full = padded(Columns(*(jnp.asarray(x, float) for x in data)))
    keys = jax.random.split(jax.random.PRNGKey(seed), chains)
    found = _drawn(full, keys, PASSES[0], warmup)
    return found if found.status is PosteriorStatus.CONVERGED else _drawn(full, keys, PASSES[1], warmup)


def _drawn(data: Columns, keys: Array, length: tuple[int, int], warmup: int) -> SelectionDraws:
    """All chains, as many at a time as there are cores; the first compiles the program."""

    def one(key: Array):
        return jax.tree.map(np.asarray, _chain(data, key, jnp.array(length[0]), warmup, length[1]))

    with ThreadPoolExecutor(max(1, min(len(keys), cores()))) as pool:
        parts = [one(keys[0]), *pool.map(one, keys[1:])]
    members, v = (np.stack([part[i] for part in parts]) for i in range(2))
    statistics = {name: np.stack([part[2][name] for part in parts]) for name in parts[0][2]}
    rhat, ess = _convergence(members, v, statistics["density"])
    divergent = float(statistics["diverging"].mean())
    status = PosteriorStatus.CONVERGED if rhat <= TARGET_RHAT and ess >= TARGET_ESS else PosteriorStatus.NOT_CONVERGED
    status = PosteriorStatus.DIVERGENT if divergent > DIVERGENT_SHARE else status
    return SelectionDraws(members, np.exp(v[..., 0]), np.exp(v[..., 1]), status, rhat, ess, divergent)


def _convergence(members: np.ndarray, v: np.ndarray, density: np.ndarray) -> tuple[float, float]:
    """Largest R-hat and least effective sample size; what never changes has none."""
    count = int(members.max()) + 1
    shares = np.array([(members == j).any(axis=2).mean() for j in range(count)])
    open_ones = np.flatnonzero((shares > TWO_SIDED[0]) & (shares < TWO_SIDED[1]))
    series = {"sigma": v[..., 0], "tau": v[..., 1], "density": density, "size": (members >= 0).sum(axis=2) * 1.0}
    series |= {f"column {j}": (members == j).any(axis=2) * 1.0 for j in open_ones}
    moving = {name: x for name, x in series.items() if np.ptp(x) > 0.0}
    found = diagnose(np.stack(list(moving.values()), axis=2), tuple(moving))
    return max(m.rhat for m in found.values()), min(m.ess_bulk for m in found.values())
