"""Lateral effects: signs that mechanics gives them in body axes x forward, y right, z down."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_aero.effects import CATALOGUE
from bayes_aero.flight.axes import Axis
from bayes_aero.model.model import Model
from bayes_aero.report.text.restraints import sign_sentences

BOTH = tuple(Axis)
REST = {"alpha": 0.1, "beta": 0.0, "p": 0.0, "r": 0.0, "aileron": 0.0, "rudder": 0.0, "airspeed": 80.0}

STABLE = [  # a motion to the right, and the side on which a stable aircraft of usual controls answers it
    ("sideslip_side_force", "beta", "CY", -1),  # the wind from the right pushes to the left
    ("sideslip_roll", "beta", "Cl", -1),  # the right wing rises
    ("sideslip_yaw", "beta", "Cn", +1),  # the nose turns into the wind
    ("roll_damping", "p", "Cl", -1),
    ("yaw_damping", "r", "Cn", -1),
    ("yaw_rate_roll", "r", "Cl", +1),  # the left wing is faster and rises
    ("roll_rate_yaw", "p", "Cn", -1),  # lift of the right wing, which goes down, leans forward
    ("aileron_roll", "aileron", "Cl", -1),  # the right aileron down lifts the right wing
    ("rudder_side_force", "rudder", "CY", +1),  # the trailing edge left pushes the fin to the right
    ("rudder_yaw", "rudder", "Cn", -1),  # and the nose to the left
]


@pytest.mark.parametrize(("name", "channel", "coefficient", "side"), STABLE)
def test_defaults_have_the_sign_of_a_stable_aircraft(card, name, channel, coefficient, side):
    model = Model.of([name], axes=BOTH)
    signals = {key: np.array([x]) for key, x in (REST | {channel: 0.1}).items()}
    known = model.flow({p.name: p.start for p in model.parameters}, signals, card.aircraft)
    assert side * float(known[coefficient][0]) > 0.0
    others = {"CL", "CD", "Cm", "CY", "Cl", "Cn"} - {coefficient}
    assert all(float(known[key][0]) == 0.0 for key in others)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("CYbe", "wrong sign"), ("Clbe", "wrong sign"), ("Cnbe", "wrong sign"), ("Clda", "sign of aileron is"),
        ("Cndr", "sign of rudder is"), ("CYdr", "sign of rudder"), ("Clp", "impossible"), ("Cnr", "impossible"),
    ],
)  # fmt: skip
def test_an_estimate_on_the_other_side_is_told(name, said):
    parameters = [p for effect in CATALOGUE.values() for p in effect.parameters]
    (usual,) = (p.start for p in parameters if p.name == name)
    (sentence,) = sign_sentences({name: (-usual, 0.001)}, parameters)
    assert said in sentence
    assert sign_sentences({name: (usual, 0.001)}, parameters) == []


def test_spoilers_of_one_side_roll_and_yaw_to_it_and_alike_ones_do_nothing(card):
    model = Model.of(["spoiler_roll", "spoiler_yaw"], axes=BOTH)
    values = {"Clds": 0.1, "Cnds": 0.02}
    deflected = {"alpha": [0.1, 0.1], "spoiler_left": [0.0, 0.3], "spoiler_right": [0.3, 0.3]}
    known = model.flow(values, {name: np.array(x) for name, x in deflected.items()}, card.aircraft)
    assert np.asarray(known["Cl"]) == pytest.approx([0.015, 0.0], abs=1e-15)
    assert np.asarray(known["Cn"]) == pytest.approx([0.003, 0.0], abs=1e-15)
