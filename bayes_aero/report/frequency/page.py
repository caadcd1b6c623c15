"""What the page of a fit to trajectories shows of the frequency domain."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bayes_aero.diagnosis.trajectories.results import TrajectoryFit
from bayes_aero.report.frequency.tables import frequency_sentences
from bayes_aero.report.html.page import Block
from bayes_aero.report.html.parts import bullets
from bayes_aero.report.html.pictures import Gallery
from bayes_aero.report.text.phrases import several

BODE = (
    "Responses of the outputs to the inputs: measured by cross spectra, with 95 % bars, where the standard error is "
    "below 30 %; modelled, with the 95 % band of the estimates. Coherence: the share of an output that all inputs "
    "explain. Inputs that respond to others, as sideslip to the rudder, bias measured responses, not the fits."
)


def frequency_blocks(flown: TrajectoryFit, figures: Mapping[str, Path]) -> tuple[Block, ...]:
    """Estimates in the band and responses; nothing where no band was asked for."""
    if not flown.frequency:
        return ()
    coherent = several(f"{r.output} over {r.input} {np.median(r.coherence):.2f}" for r in flown.frequency_responses)
    gallery = Gallery(figures, {"bode": (BODE, f"Bode plots. Median coherence: {coherent}.")})
    said = [sentence for fit in flown.frequency for sentence in frequency_sentences(fit)]
    return (*bullets(said), *gallery("bode"))
