"""How much the posterior of the stall model leans on its priors, on records or the simulated manoeuvres.

python benchmarks/sensitivity.py [RECORD ...] [--model CARD]
"""

from __future__ import annotations

from studies import plain_parser, records_of

from bayes_aero.inference.mle import fit_mle
from bayes_aero.inference.sampling import density_start, find_mode, prior_sensitivity, sample_ensemble
from bayes_aero.model.model import Model
from bayes_aero.model.observations import Colour, Density, Noise, observe


def main() -> None:
    """Print the power-scaling of every parameter."""
    _, card, records = records_of(plain_parser(__doc__), least=0)
    model = Model.from_card(card)
    observations = observe(records, card, model)
    mle = fit_mle(model, observations)
    for colour in (Colour.AR1, Colour.WHITE):
        density = Density.of(observations, model, Noise(colour))
        posterior = sample_ensemble(density, find_mode(density, density_start(density, mle)), predictive=False)
        print(f"\n{colour.value} noise, {posterior.status.value}")
        print(prior_sensitivity(density, posterior).to_string(float_format=lambda v: f"{v:.3f}"))


if __name__ == "__main__":
    main()
