"""What the published six-coefficient model of ATTAS gets wrong, judged on flights that nobody fitted it to.

    python benchmarks/three_axes.py ../shared/book

Diagnoses the card full_six on `fAttasElv1`, `fAttasAil1` and `fAttasRud1` (TC23) and predicts the repeats, `fAttasElv2`
and both parts of `fAttasAilRud2`, with the card's model and the extended one as fitted: R2 of each coefficient.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from bayes_aero.diagnosis.diagnose import diagnose
from bayes_aero.flight.card.card import read_card
from bayes_aero.flight.reading.read_record import manoeuvres, read_record
from bayes_aero.inference.scores import score
from bayes_aero.model.joined_channels import join
from bayes_aero.physics.coefficient_names import required_of
from bayes_aero.residuals.equation_error import EquationError

SEEN = ("fAttasElv1.mat", "fAttasAil1.mat", "fAttasRud1.mat")
REPEATS = ("fAttasElv2.mat", "fAttasAilRud2.mat")


def main(folder: Path) -> None:
    """Diagnose, predict, print."""
    card = read_card("full_six")
    seen, repeats = (
        [
            read_record(path, card.channels)
            for path in manoeuvres([folder / n for n in names], card.channels, split=True)
        ]
        for names in (SEEN, REPEATS)
    )
    found = diagnose(seen, card, process_noise=False)
    print(found.verdict.value)
    for cause in found.causes:
        sizes = ", ".join(f"{name} {size.mean:.4g} +- {size.sd:.2g}" for name, size in cause.parameters.items())
        print(f"  {cause.name}{'' if cause.confirmed else ' (not confirmed)'}: {sizes} {cause.ambiguous_with or ''}")
    for one in found.unknown:
        print(f"  unexplained: {one.coefficient} over {one.channel}, {one.share:.0%}")
    state, base = found.aerodynamics.state, found.aerodynamics.base
    print(f"R2 on repeats\n{'':24}" + "".join(f"{name:>16}" for name in state.outputs))
    for record in repeats:
        responses = EquationError.of(join([record], card, required_of(card.axes)), state.full.model)
        rows = []
        for theta in (base.full.at_neutral(base.theta, [e.name for e in base.full.candidates]), state.theta):
            known = responses.evaluate(theta)[1]
            measured, residual = (np.asarray(known[name]) for name in ("measured", "residual"))
            rows.append(
                [score(z, z - e).r2 for z, e in zip(measured.T, residual[:, : measured.shape[1]].T, strict=True)]
            )
        print(f"{record.name:24}" + "".join(f"{a:8.3f}{b:8.3f}" for a, b in zip(*rows, strict=True)))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
