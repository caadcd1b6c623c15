"""A derivative of a control at rest takes up what is constant: by how much, in closed form, and where it does not."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest
from test_mixing import part

from bayes_aero.diagnosis.candidate_set import CandidateModel
from bayes_aero.diagnosis.diagnose import judged_on_held_out_flights
from bayes_aero.diagnosis.result import Verdict, as_absorbed
from bayes_aero.diagnosis.screening.accuracy import Size
from bayes_aero.diagnosis.screening.regression import Products
from bayes_aero.diagnosis.screening.selection_state import SelectionState
from bayes_aero.diagnosis.selection.absorbed import Absorbed, absorbed
from bayes_aero.diagnosis.selection.backward_elimination import Confirmation
from bayes_aero.diagnosis.selection.forward_selection import Extension
from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.axes import Axis
from bayes_aero.jobs.io.diagnosis_json import absorbed_results
from bayes_aero.model.model import Model
from bayes_aero.report.text.diagnosis import diagnosis_sentences

OUTPUTS = ("CY", "Cl", "Cn")
NOISE, SAMPLES = 1e-5, 400
USUAL, WIDTH = CATALOGUE["rudder_yaw"].parameters[0].prior.normal


def fitted(rudder: np.ndarray, hidden: float) -> Extension:
    """A card that knows of yaw only the rudder, fitted to a rudder as usual and a yawing moment without cause."""
    model = Model.of(["rudder_yaw", "yaw_offset"], axes=tuple(Axis))
    full = CandidateModel(model, ("rudder_yaw",), (CATALOGUE["yaw_offset"],), {})
    S = np.zeros((SAMPLES, 3, 3))
    S[:, 2, model.names.index("Cndr")], S[:, 2, model.names.index("Cn0")] = rudder, 1.0
    folds = (slice(0, 200), slice(200, SAMPLES))
    measured = NOISE * np.random.default_rng(5).standard_normal((SAMPLES, 3))
    measured[:, 2] += hidden + USUAL * rudder

    def at(theta: np.ndarray) -> SelectionState:
        residual = measured - S[:, :, :2] @ theta
        mean, precision = full.prior(range(2), theta)
        mean, precision = np.append(mean, 0.0), np.append(precision, 1.0)
        return part(
            SelectionState, full=full, outputs=OUTPUTS, theta=theta, residual=residual, S=S, folds=folds, scans=(),
            noise_growth=np.ones((SAMPLES, 3)), products=Products.of(residual, S, folds), mean=mean, nuisance=0,
            precision=precision, active=(), chosen=(), components=(), variance_inflation=1.0,
            responses=SimpleNamespace(model=SimpleNamespace(coefficients=OUTPUTS)),
        )  # fmt: skip

    theta = np.zeros(2)
    theta[model.names.index("Cndr")] = at(theta).fit().step.sum()  # one, or none where the rudder makes nothing
    state = at(theta)
    sizes = {"Cndr": Size(float(theta[model.names.index("Cndr")]), 1e-3, "1/rad")}
    return part(Extension, state=state, fit=state.fit(), sizes=sizes)


def test_what_a_rudder_at_rest_takes_up_has_the_size_that_it_has_with_a_usual_rudder():
    """Cn0 = (Cndr - usual) dr, and its deviation that of the prior times dr."""
    held, hidden = 0.0075, 9e-4
    (found,) = absorbed(fitted(np.full(SAMPLES, held), hidden))
    assert (found.effect, found.parameter, found.control) == ("rudder_yaw", "Cndr", "rudder")
    assert found.estimate[0] == pytest.approx(USUAL + hidden / held, abs=0.01)
    assert found.usual == (USUAL, WIDTH)
    assert found.members == {"rudder_yaw", "yaw_offset"}
    size = found.sizes["yaw_offset"]
    mean, sd = size.mean, size.sd
    assert mean == pytest.approx(hidden, rel=0.02)
    assert sd == pytest.approx(WIDTH * held, rel=0.05)


@pytest.mark.parametrize(
    ("held", "moves", "hidden"),
    [
        (0.0075, 0.02, 9e-4),  # it moves, and tells its derivative
        (0.0, 0.0, 9e-4),  # neutral, it makes nothing
        (1e-4, 0.0, 9e-4),  # so little aside that it would need a derivative that no rudder has
        (0.0075, 0.0, 2e-4),  # what it takes up is not worth a name
        (0.0075, 0.0, 0.02),  # nor is there so much on any aircraft
    ],
)
def test_elsewhere_nothing_is_taken_up(held, moves, hidden):
    rudder = held + moves * np.sin(np.arange(SAMPLES) / 9.0)
    assert absorbed(fitted(rudder, hidden)) == ()


def test_a_verdict_of_no_effect_is_not_decided_then(diagnosed):
    found = absorbed(fitted(np.full(SAMPLES, 0.0075), 9e-4))
    assert as_absorbed(Verdict.NO_EFFECT, found) is Verdict.UNDECIDED
    assert as_absorbed(Verdict.NO_EFFECT, ()) is Verdict.NO_EFFECT
    assert as_absorbed(Verdict.EXPLAINED, found) is Verdict.EXPLAINED
    silent = replace(diagnosed.view.diagnosis, causes=(), unknown=(), changes=(), tested=None)
    for taken_up, verdict in ((found, Verdict.UNDECIDED), ((), Verdict.NO_EFFECT)):
        after = judged_on_held_out_flights(replace(silent, absorbed=taken_up), Confirmation((), {}))
        assert after.verdict is verdict


def test_it_is_said_with_both_values_and_the_sizes_that_follow(diagnosed):
    sizes = {"thrust_scale": Size(-0.1, 0.2, "1")}
    one = Absorbed("elevator_moment", "Cmde", "1/rad", "elevator", (-0.2, 0.01), (-1.0, 0.5), sizes)
    said = diagnosis_sentences(replace(diagnosed.view.diagnosis, absorbed=(one,)))
    (sentence,) = (x for x in said if "elevator does not move" in x)
    for told in ("Cmde", "-0.200 ± 0.010", "-1.00 ± 0.50", "thrust_scale", "cannot tell which"):
        assert told in sentence


def test_a_reader_of_the_file_gets_the_same_numbers(diagnosed):
    sizes = {"thrust_scale": Size(-0.1, 0.2, "1")}
    one = Absorbed("elevator_moment", "Cmde", "1/rad", "elevator", (-0.2, 0.01), (-1.0, 0.5), sizes)
    schema = json.loads(resources.files("bayes_aero.jobs.io.schemas").joinpath("diagnosis.schema.json").read_text())
    written = absorbed_results(replace(diagnosed.view.diagnosis, absorbed=(one,)))
    jsonschema.validate(written, schema["properties"]["absorbed"] | {"$defs": schema["$defs"]})
    assert written[0]["usual"] == {"mean": -1.0, "sd": 0.5}
    assert written[0]["sizes"] == {"thrust_scale": {"mean": -0.1, "sd": 0.2, "unit": "1"}}
