"""Do intervals of parameters fitted to trajectories hold the truth, where the flight itself is disturbed?

    python benchmarks/flown_coverage.py 30 --first 91000      # pairs of stalls for each kind of noise

Nothing is hidden: the card's model is the truth, its parameters drawn for each pair, and fitted as `fly` does.
Sensors are noisy, those of recorded inputs too (`white`); in `ar1` and `buffet` the coefficients are disturbed as well.
"""

from __future__ import annotations

import argparse

import jax
import numpy as np

from bayes_aero.flight.card.card import read_card
from bayes_aero.jobs.fly import fly
from bayes_aero.simulate.injection import hidden_flights

NOISES = ("white", "ar1", "buffet")


def main() -> None:
    """Fly, fit, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int)
    parser.add_argument("--first", type=int, default=91000)
    given = parser.parse_args()
    card = read_card("attas")
    for noise in NOISES:
        white, corrected, lost = [], [], 0
        for seed in range(given.first, given.first + given.count):
            jax.clear_caches()  # a process holds only so many programs
            flights = hidden_flights({}, seed=seed, seconds=90.0, noise=noise)
            found = fly([f.record for f in flights], card, figures=False).flown
            if not found.converged:
                lost += 1
                continue
            off = found.fit.estimate - np.array([flights[0].values[name] for name in found.fit.names])
            white.append(off / found.fit.sd)
            corrected.append(off / found.fit.sd_corrected)
            print(noise, seed, f"{np.mean(np.abs(corrected[-1]) < 1.96):.2f}", flush=True)
        for name, z in (("Cramer-Rao", np.array(white)), ("corrected", np.array(corrected))):
            inside, spread = np.mean(np.abs(z) < 1.96), np.median(np.sqrt(np.mean(z**2, axis=0)))
            print(f"{noise}: {name}: {inside:.2f} inside 95 %; off by {spread:.1f} deviations (RMS, median parameter)")
        print(f"{noise}: {len(white)} fitted, {lost} did not converge", flush=True)


if __name__ == "__main__":
    main()
