"""Is a lag of the separation point kept where there is none? Stalls with nothing or another effect hidden.

    python benchmarks/flown_lag.py 40 --first 70000             # as `bayes-aero diagnose` asks
    python benchmarks/flown_lag.py 40 --first 70000 --forced    # asked of every flight, whatever the coefficients say
    python benchmarks/flown_lag.py 20 --first 72000 --hidden    # with a lag of 4 to 16 chords hidden

One line a pair of manoeuvres, and the counts at the end.
"""

from __future__ import annotations

import argparse
from collections import Counter

import jax
import numpy as np

from bayes_aero.diagnosis.candidate_set import lag_of
from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.trajectories import trajectories as trajectory
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.effect import Stage
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import read_card
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.simulate.injection import hidden_records

NOISES = ("ar1", "buffet", "white", "outliers")
OTHERS = (
    {},
    {},
    {"thrust_moment": {"thrust_arm": 0.5}},
    {"separation_hysteresis": {"tau2_both": 12.0}},
    {"stabilizer_trim": {"Cmih": -0.9}},
    {"separated_elevator": {"CmdeX": 0.3}},
    {"alpha_delay": {"alpha_delay": 0.1}},
    {"pitch_rate_lift": {"CLq": 6.0}},
    {"vertical_wind": {"vertical_wind": 1.0}},
    {"separated_damping": {"CmqX": 5.0}},
)


def whatever(field, _found, model):
    """In place of `open_lag`: the catalogue's lag wherever it can be tried."""
    return None if any(e.stage is Stage.LAG for e in model.acting) else lag_of(field)


def main() -> None:
    """Fly, diagnose, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int)
    parser.add_argument("--first", type=int, default=70000)
    parser.add_argument("--forced", action="store_true")
    parser.add_argument("--hidden", action="store_true")
    given = parser.parse_args()
    if given.forced:
        trajectory.open_lag = whatever
    card, counts = read_card("attas"), Counter()
    for seed in range(given.first, given.first + given.count):
        jax.clear_caches()  # every flight has programs of its own, and a process holds only so many
        effects = OTHERS[seed % len(OTHERS)]
        if given.hidden:
            effects = {"separation_lag": {"tau1": float(np.random.default_rng(seed).uniform(4.0, 16.0))}}
        noise = NOISES[seed % len(NOISES)]
        try:
            records = hidden_records(effects, seed=seed, seconds=95.0, noise=noise)
            found = diagnose(records, card, gains_wanted=False)
            flown = trajectory.compare_trajectories(despiked(join(records, card, FLIGHT))[0], found, {})
        except InputError as reason:
            counts["not flown"] += 1
            print(seed, effects, noise, reason, flush=True)
            continue
        named = [cause.name for cause in found.causes]
        counts["tried"] += flown.lag is not None
        counts["kept"] += flown.lag is not None and flown.lag.kept
        counts["named from coefficients"] += "separation_lag" in named
        counts["all"] += 1
        print(seed, effects, noise, named, flown.lag, flown.extended.values.get("tau1"), flush=True)
    print(dict(counts))


if __name__ == "__main__":
    main()
