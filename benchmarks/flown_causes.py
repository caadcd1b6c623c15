"""Does unseen flight miss a cause that is there, and not one that is not? Stalls with one effect hidden, one put in.

    python benchmarks/flown_causes.py 30 --first 81000
    python benchmarks/flown_causes.py 30 --first 82000 --alone    # nothing put in

Two manoeuvres are diagnosed; to the causes that they have, one that they have not is added by hand, and trajectories
are asked of all of them as `bayes-aero diagnose` asks. A third manoeuvre, new to everything, is flown with the
parameters before and after: `third` is the log density that it gains by what was taken out. One line a seed, counts at
the end.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace

import jax
import numpy as np
from hidden_effects import NOISES, candidates

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.diagnosis.trajectories import trajectories as trajectory
from bayes_aero.diagnosis.trajectories.log_score import HoldoutScore, holdout_gain
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.output_channels import FLIGHT
from bayes_aero.dynamics.segments import segments
from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card.card import read_card
from bayes_aero.inference.likelihood.output_error import fit_output_error
from bayes_aero.model.joined_channels import despiked, join
from bayes_aero.simulate.injection import flyable


class Watch:
    """`eliminate`, and what it was given and gave last."""

    def __init__(self):
        self.asked, trajectory.eliminate = trajectory.eliminate, self

    def __call__(self, contender, *rest):
        """As the function itself."""
        found = self.asked(contender, *rest)
        self.before, self.after, self.inflation = contender, found.contender, rest[-1].variance_inflation
        return found

    def gain_on(self, record, card) -> float:
        """Log density of a new manoeuvre by what was taken out, outputs that were fitted."""
        flights, flown = despiked(join([record], card, FLIGHT))[0], []
        for contender in (self.before, self.after):
            fit = contender.fit
            dynamics = aircraft_dynamics(fit.flown.dynamics.model, flights)
            values = dict(zip(fit.names, map(float, fit.estimate), strict=True))
            start = np.array([values[name] for name in dynamics.names])
            whole = segments(flights, dynamics, outputs=fit.flown.outputs, substeps=fit.flown.substeps)
            own = fit_output_error(whole, start=start, held=values, prior_weight=self.inflation)
            flown.append(HoldoutScore((own.columns[0, ..., 0][whole.inside[0]],)))
        return holdout_gain(*flown, self.inflation)[0]


def put_in(found, true: str, rng: np.random.Generator) -> str | None:
    """One effect of the hidden one's kind that the diagnosis has not."""
    named = [c.name for c in found.causes]
    kind = CATALOGUE[true].kind
    absent = [e.name for e in found.aerodynamics.state.full.candidates if e.kind is kind and e.stage is not Stage.LAG]
    absent = sorted(set(absent) - set(named))
    return str(rng.choice(absent)) if absent else None


def main() -> None:
    """Fly, diagnose, add, ask, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int)
    parser.add_argument("--first", type=int, default=81000)
    parser.add_argument("--alone", action="store_true", help="put nothing in")
    given = parser.parse_args()
    card, counts, third, watch = read_card("attas"), Counter(), [], Watch()
    for seed in range(given.first, given.first + given.count):
        jax.clear_caches()  # every pair of effects has programs of its own, and a process holds only so many
        rng = np.random.default_rng([seed, 7])
        noise, true = str(rng.choice(NOISES)), str(rng.choice(candidates()))
        try:
            hidden, flights = flyable([true], seed=seed, noise=noise, seconds=90.0, manoeuvres=3)
            records = [flight.record for flight in flights]
            found = diagnose(records[:2], card)
            named, false = [c.name for c in found.causes if c.confirmed], put_in(found, true, rng)
            if true not in named or (false is None and not given.alone):
                print(seed, noise, hidden, "not named, or not confirmed:", named, flush=True)
                continue
            if not given.alone:
                found = replace(found, causes=(*found.causes, replace(found.causes[0], name=false)))
            flown = trajectory.compare_trajectories(despiked(join(records[:2], card, FLIGHT))[0], found, {})
            gain = watch.gain_on(records[2], card) if flown.out else 0.0
        except InputError as reason:
            print(seed, noise, reason, flush=True)
            continue
        asked = flown.asked
        counts["all"] += 1
        counts["hidden: asked"] += true in asked.missed
        counts["hidden: kept"] += true in asked.kept
        counts["put in: asked"] += false in asked.missed
        counts["put in: taken out"] += false in flown.out
        if flown.out:
            third.append(gain)
        told = {e: tuple(round(x, 1) for x in missed) for e, missed in asked.missed.items()}
        print(seed, noise, hidden, told, "out:", flown.out, f"third: {gain:+.1f}", flush=True)
    print(dict(counts), "third manoeuvre better in", sum(x > 0.0 for x in third), "of", len(third), np.round(third, 1))


if __name__ == "__main__":
    main()
