"""Is the pooling of manoeuvres calibrated?

    python benchmarks/next_flight.py ranks [--replicates 500] [--manoeuvres 2 9]
    python benchmarks/next_flight.py flights [--aircraft 40] [--manoeuvres 4]

`ranks` is simulation-based calibration: aircraft, scatter and manoeuvres are drawn from their priors, estimates with
correlated errors follow, one manoeuvre says nothing of one parameter. Ranks of aircraft, scatter, first manoeuvre and
next flight must be uniform, and intervals must contain a next flight as often as they say.

`flights` goes through the whole of `identify --next-flight`: stalls of one aircraft whose parameters scatter, simulated
with sensor noise and buffet; the true parameters of one more stall are looked for in the intervals.
"""

from __future__ import annotations

import time
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from calibration import band_of, rank
from studies import plain_parser, print_inside

from bayes_aero.flight.card import read_card
from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.pooled import SCATTER, Hierarchy, from_prior_units, next_flight, pool, to_prior_units
from bayes_aero.inference.sampling import NutsLength
from bayes_aero.model.model import Model
from bayes_aero.model.observations import DEFAULT, Density, Noise, Observations, observe
from bayes_aero.simulate.demo import DISTURBANCE, TRUTH, simulate_stall

NAMES = ("first", "second", "third")
SPREAD = 0.15  # of the flown aircraft between stalls, in standard deviations of the priors
WIDTHS = (0.5, 0.9, 0.95)
LENGTH = NutsLength(warmup=300, max_blocks=2)


def drawn(rng: np.random.Generator, manoeuvres: int) -> tuple[dict[str, np.ndarray], Hierarchy]:
    """True values from their priors, and the density of estimates of them."""
    k = len(NAMES)
    aircraft, scatter = rng.standard_normal(k), SCATTER * np.abs(rng.standard_normal(k))
    flown = aircraft + scatter * rng.standard_normal((manoeuvres, k))
    size = 10.0 ** rng.uniform(-2.0, -0.3, (manoeuvres, k))  # standard errors in units of the priors
    mixed = size[..., None] * (np.eye(k) + 0.7 * rng.standard_normal((manoeuvres, k, k)))
    estimate = flown + (mixed @ rng.standard_normal((manoeuvres, k, 1)))[..., 0]
    information = np.linalg.inv(mixed @ np.swapaxes(mixed, 1, 2))
    rest = np.linalg.inv(information[-1])[1:, 1:]  # the last manoeuvre says nothing of the first parameter
    information[-1] = 0.0
    information[-1, 1:, 1:] = np.linalg.inv(rest)
    following = aircraft + scatter * rng.standard_normal(k)
    truth = {"aircraft": aircraft, "scatter": scatter, "first manoeuvre": flown[0], "next flight": following}
    return truth, Hierarchy.of(NAMES, estimate, information)


def ranks(replicates: int, manoeuvres: int) -> None:
    """Simulation-based calibration."""
    rng, began = np.random.default_rng([7, manoeuvres]), time.perf_counter()
    found: dict[str, list[np.ndarray]] = {}
    inside, unsure, narrowed = np.zeros(len(WIDTHS)), 0, []
    for number in range(replicates):
        truth, density = drawn(rng, manoeuvres)
        draws, sampled = pool(density, seed=number, length=LENGTH)
        parts = (draws.aircraft, draws.scatter, draws.manoeuvres[:, :, 0], draws.following)
        flat = {what: x.reshape(-1, len(NAMES)) for what, x in zip(truth, parts, strict=True)}
        for what, x in flat.items():
            found.setdefault(what, []).append(rank(truth[what], x))
        ends = [np.quantile(flat["next flight"], [0.5 - w / 2, 0.5 + w / 2], axis=0) for w in WIDTHS]
        inside += [np.sum((truth["next flight"] > low) & (truth["next flight"] < high)) for low, high in ends]
        unsure += sampled.status.name != "CONVERGED"
        narrowed.append([m.sd / (SCATTER * np.sqrt(1.0 - 2.0 / np.pi)) for m in sampled.marginals.values()])
    total = replicates * len(NAMES)
    print(f"{manoeuvres} manoeuvres, {replicates} replicates of {len(NAMES)} parameters: ", end="")
    print(f"{time.perf_counter() - began:.0f} s, {unsure} not converged")
    for what, one in found.items():
        bands = [band_of(each) for each in np.transpose(one)]
        said = ", ".join("inside" if inside else "OUTSIDE" for inside, _ in bands)
        print(f"  ranks of {what}: {said} (largest difference {max(largest for _, largest in bands):.3f})")
    shares = ", ".join(f"{w:.0%}: {n / total:.1%}" for w, n in zip(WIDTHS, inside, strict=True))
    print(f"  next flight inside its intervals: {shares} of {total}")
    print(f"  standard deviation of the scatter over its prior's, median: {np.median(narrowed):.2f}", flush=True)


def _flown(density: Density, theta: np.ndarray, rng: np.random.Generator) -> Observations:
    """Coefficients of one stall with coloured noise that grows as the flow separates."""
    noise = [DISTURBANCE.get(p.name, p.start) for p in density.noise.parameters]
    x = jnp.asarray([*theta, *noise])
    o = density.observations
    return o.with_measured(density.replicate(x, jnp.asarray(rng.standard_normal(o.measured.shape))))


def fly_again(aircraft: int, manoeuvres: int) -> None:
    """How often the true parameters of one more stall lie in the 95 % intervals of the next flight."""
    card = read_card("attas")
    model, began = Model.from_card(card), time.perf_counter()
    clean = observe([simulate_stall(i, card=card, sensor_noise=0.0, disturbance=0.0) for i in range(2)], card, model)
    parts = [Density.of(clean.only(m % 2), model, Noise(DEFAULT)) for m in range(2)]
    centre = np.array([float(to_prior_units(p.prior, TRUTH[p.name])) for p in model.free])
    inside, jointly, truly = [], [], []
    for number in range(aircraft):
        rng = np.random.default_rng([11, number])
        theta = [
            np.array([float(from_prior_units(p.prior, v)) for p, v in zip(model.free, one, strict=True)])
            for one in centre + SPREAD * rng.standard_normal((manoeuvres + 1, len(centre)))
        ]
        flown = [_flown(parts[m % 2], theta[m], rng) for m in range(manoeuvres)]
        flown = [replace(o, names=(f"flight{m}",)) for m, o in enumerate(flown)]
        fits = {o.names[0]: fit_mle(model, o, extra_starts=2, seed=number) for o in flown}
        found = next_flight(model, flown[0], fits, seed=number)
        low, high = np.array([found.following[n].ci95 for n in model.names]).T
        inside.append((theta[-1] > low) & (theta[-1] < high))
        low, high = np.array([found.aircraft[n].ci95 for n in model.names]).T
        at = np.array([TRUTH[n] for n in model.names])
        truly.append((at > low) & (at < high))
        weights = np.array([np.linalg.inv(f.corrected) for f in fits.values()])
        covariance = np.linalg.inv(weights.sum(axis=0))
        common = covariance @ sum(w @ f.estimate for w, f in zip(weights, fits.values(), strict=True))
        jointly.append(np.abs(theta[-1] - common) < 1.96 * np.sqrt(np.diag(covariance)))
    seconds = time.perf_counter() - began
    print(f"{aircraft} aircraft of {manoeuvres} stalls, scatter {SPREAD} of the priors', {seconds:.0f} s")
    for what, one in (
        ("next stall in the interval of the next flight", inside),
        ("next stall in the interval of one value for all", jointly),
        ("true aircraft in its interval", truly),
    ):
        print(what)
        print_inside(model.names, np.array(one))


def main() -> None:
    parser = plain_parser(__doc__)
    parser.add_argument("part", choices=("ranks", "flights"))
    parser.add_argument("--replicates", type=int, default=500)
    parser.add_argument("--aircraft", type=int, default=40)
    parser.add_argument("--manoeuvres", type=int, nargs="+")
    given = parser.parse_args()
    if given.part == "ranks":
        for manoeuvres in given.manoeuvres or (2, 9):
            ranks(given.replicates, manoeuvres)
    else:
        fly_again(given.aircraft, (given.manoeuvres or [4])[0])


if __name__ == "__main__":
    main()
