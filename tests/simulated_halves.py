"""Simulated trajectories made by hand, so that every error is known beforehand."""

import numpy as np

from bayes_aero.diagnosis.result import Error, SimulatedManoeuvre, Trajectories, TrajectoryEstimates, theil_parts
from bayes_aero.flight.record import FlightRecord
from bayes_aero.inference.results import OutputErrorStatus


def halves(record: FlightRecord) -> Trajectories:
    """Two simulated halves of a record: the card's model off by 1 deg, the extended one by a tenth of it."""
    paths, middle = [], record.n // 2
    for name, half in (("a, first half", slice(None, middle)), ("a, second half", slice(middle, None))):
        measured = {output: np.array(record[output][half]) for output in ("airspeed", "alpha")}
        for model, off in (("card", np.deg2rad(1.0)), ("extended", np.deg2rad(0.1))):
            simulated = {output: x + off for output, x in measured.items()}
            errors = {
                output: Error(off, off, theil_parts(x, simulated[output]), 0.02, 1.0, 0.5)
                for output, x in measured.items()
            }
            paths += [
                SimulatedManoeuvre(name, model, split, True, errors, np.array(record.time[half]), measured, simulated)
                for split in ("fitted", "hold_out")
            ]
    fit = TrajectoryEstimates({}, {}, OutputErrorStatus.CONVERGED, (), ())
    outputs = ("airspeed", "alpha")
    return Trajectories(tuple(paths), fit, fit, {}, 1.0, {}, outputs, outputs)
