"""How much the stall posterior leans on its priors (power-scaling), on records or on the simulated manoeuvres.

python benchmarks/prior_sensitivity.py [RECORD ...] [--model CARD]
"""

from __future__ import annotations

import argparse
from pathlib import Path

from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.reading.read_record import read_records
from bayes_aero.inference.likelihood.mle import fit_mle
from bayes_aero.inference.posterior.ensemble import sample_ensemble
from bayes_aero.inference.posterior.laplace import density_start, find_mode
from bayes_aero.inference.posterior.prior_sensitivity import prior_sensitivity
from bayes_aero.model.density import Density
from bayes_aero.model.model import Model
from bayes_aero.model.noise import Colour, Noise
from bayes_aero.model.observations import observe
from bayes_aero.simulate.demo import simulate_stall

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("records", type=Path, nargs="*")
parser.add_argument("--model", default="attas")
given = parser.parse_args()
card = read_card(given.model)
model = Model.from_card(card)
records = (
    read_records(given.records, card.channels) if given.records else [simulate_stall(i, card=card) for i in range(2)]
)
observations = observe(records, card, model)
mle = fit_mle(model, observations)
for colour in (Colour.AR1, Colour.WHITE):
    density = Density.of(observations, model, Noise(colour))
    posterior = sample_ensemble(density, find_mode(density, density_start(density, mle)), predictive=False)
    print(f"\n{colour.value} noise, {posterior.status.value}")
    print(prior_sensitivity(density, posterior).to_string(float_format=lambda v: f"{v:.3f}"))
