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
RUNNING = (
    "Equation error on a recursive Fourier transform: every sample is added to its sums. Each parameter as the samples "
    "so far give it, with its 95 % band. Dashed: output error in the time domain, of the whole record. The table of "
    "parameters has equation error and output error of the whole record in the band."
)


def frequency_blocks(flown: TrajectoryFit, figures: Mapping[str, Path]) -> tuple[Block, ...]:
    """Responses, and how the parameters settle while the record grows; nothing where no band was asked for."""
    if flown.running is None:
        return ()
    run = flown.running
    last = several(f"{name} {x:.3g}" for name, x in zip(run.names, run.value[-1], strict=True))
    coherent = several(f"{r.output} over {r.input} {np.median(r.coherence):.2f}" for r in flown.frequency_responses)
    gallery = Gallery(
        figures,
        {
            "bode": (BODE, f"Bode plots. Median coherence: {coherent}."),
            "running": (RUNNING, f"Time histories of the estimates and their bands. At the end, SI: {last}."),
        },
    )
    said = [sentence for fit in flown.frequency for sentence in frequency_sentences(fit)]
    return (*bullets(said), *gallery("bode"), *gallery("running"))
