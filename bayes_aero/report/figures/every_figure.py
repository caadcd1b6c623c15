"""Every figure of a report by the stem of its file, and one function that writes them all."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from matplotlib.figure import Figure

from bayes_aero.errors import failure
from bayes_aero.progress import Progress, quiet
from bayes_aero.report.figures import diagnosis, posterior, time_histories
from bayes_aero.report.style import Drawing, NotDrawn, save

if TYPE_CHECKING:
    from bayes_aero.diagnosis.result import View

ViewFigures = Mapping[str, Callable[["View"], Figure]]
FIGURES: dict[str, Drawing] = dict(sorted((posterior.FIGURES | time_histories.FIGURES).items()))
"""What an identification shows: the seed paper's nine under its numbers, then what Bayesian identification adds."""
DIAGNOSIS_FIGURES: ViewFigures = (
    diagnosis.DIAGNOSIS_FIGURES | posterior.DIAGNOSIS_FIGURES | {"trajectories_hold_out": time_histories.hold_out}
)

Shown = TypeVar("Shown")


def draw_all(
    drawings: Mapping[str, Callable[[Shown], Figure]], shown: Shown, folder: Path, progress: Progress = quiet
) -> tuple[list[Path], tuple[str, ...]]:
    """Draw every figure for which `shown` holds something into `folder`: paths, and a sentence on each failure."""
    folder.mkdir(parents=True, exist_ok=True)
    written, failed = [], []
    for number, (stem, draw) in enumerate(drawings.items()):
        path = folder / f"{stem}.png"
        progress(f"figure {stem}", number / len(drawings))
        try:
            path.unlink(missing_ok=True)  # of an earlier run
            gc.disable()  # a figure has so many objects that all that JAX holds would be searched for cycles each time
            written.append(save(draw(shown), path))
        except NotDrawn:
            continue
        except Exception as reason:  # whatever it is, the other figures and the results stand; it is reported by name
            failed.append(failure(f"Figure {stem} was not drawn", reason, folder.parent))
        finally:
            gc.enable()
    progress("figures", 1.0)
    return written, tuple(failed)
