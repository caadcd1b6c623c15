"""Cards: what can be wrong with one, and effects of a user in a file that it names and that is trusted no further."""

import copy
import tomllib
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from bayes_aero.diagnosis.selection_state import candidate_model
from bayes_aero.dynamics.flight import aircraft_dynamics
from bayes_aero.dynamics.pilot import FlightState, Plant, fly_standard
from bayes_aero.dynamics.trim import Condition
from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.errors import InputError
from bayes_aero.flight.card import parse_card, read_card, shipped_cards
from bayes_aero.model.model import Model, own_effects
from bayes_aero.parameter import Parameter, Prior, Role
from bayes_aero.simulate.demo import TRUTH


@pytest.fixture(scope="module")
def table():
    return tomllib.loads(shipped_cards()["attas"].read_text())


def test_the_shipped_card_states_the_published_model_and_tau1_may_be_freed(card, table):
    model = Model.from_card(card)
    assert set(model.names) == {
        "CD0", "e", "CDX", "CL0", "CLa", "CLaM", "Cm0", "Cma", "Cmq", "Cmde", "CmX", "a1", "alpha_star", "tau2",
    }  # fmt: skip
    assert dict(model.fixed) == {"tau1": 0.0}
    assert float(card.aircraft.mass) == 17631.0
    changed = copy.deepcopy(table)
    changed["model"].pop("fixed")
    assert "tau1" in Model.from_card(parse_card(changed, "x", "x.toml")).names


def edit(path, value):
    def change(table):
        node = table
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = value

    return change


@pytest.mark.parametrize(("change", "words"), [
    (edit(["aircaft"], {}), "aircraft"),
    (edit(["aircraft", "mass"], "17631 m"), "mass"),
    (edit(["aircraft", "mass"], "-1 kg"), "positive"),
    (edit(["channels", "alpha", "colum"], 3), "column"),
    (edit(["channels", "alpha"], {"column": 3}), "unit"),
    (edit(["channels", "alpha"], {"column": 0, "unit": "deg"}), "counted from 1"),
    (edit(["model", "effects"], []), "effects"),
    (edit(["model", "effects"], ["attached_lft"]), "attached_lift"),
    (edit(["model", "fixed"], {"tau9": 0.0}), "tau9"),
    (edit(["parameters", "CL0"], {"start": "high"}), "number"),
    (edit(["parameters", "CL0"], {"start": 3.0, "bounds": [0.0, 1.0]}), "outside its bounds"),
    (edit(["parameters", "CL0"], {"prior": {"family": "cauchy", "location": 0.0, "scale": 1.0}}), "cauchy"),
    (edit(["parameters", "CLX"], {"start": 0.0}), "CLX"),
    (edit(["sums", "thrust"], ["thrust_middle"]), "thrust_middle"),
    (edit(["sensors", "ax"], "-1 m/s^2"), "negative"),
    (edit(["tolerances", "airspeed"], "-3 kt"), "airspeed"),
    (edit(["output_biases"], {"theta": "0 deg"}), r"\[output_biases\] theta .* positive"),
])  # fmt: skip
def test_a_wrong_card_is_one_sentence(table, change, words):
    changed = copy.deepcopy(table)
    change(changed)
    with pytest.raises(InputError, match=words):
        Model.from_card(parse_card(changed, "x", "x.toml"))


def test_unknown_names_and_unowned_terms_are_told_with_a_remedy(table):
    with pytest.raises(InputError, match="attas"):
        read_card("attass")
    changed = copy.deepcopy(table)
    changed["model"]["effects"].remove("attached_lift")
    with pytest.raises(InputError, match=r"^card mine, \[model\]: .* add attached_lift to the effects$"):
        Model.from_card(parse_card(changed, "mine", "mine.toml"))


def test_tolerances_come_from_the_card_or_from_the_simulator_standard(card, table):
    assert card.tolerances["airspeed"].value == pytest.approx(3 * 1852 / 3600)
    assert card.tolerances["theta"].value == pytest.approx(np.radians(2.0))
    assert "Part 60" in card.tolerances["q"].source
    without = parse_card({name: x for name, x in table.items() if name != "tolerances"}, "x", "x.toml")
    assert without.tolerances["alpha"].value == pytest.approx(np.radians(2.0))


# A user's effect in a Python file that the card names: read, used, trusted no further than the card, and found
SOURCE = '''
"""A pitching moment from bank angle."""

import jax.numpy as jnp

from bayes_aero.effect import Effect, Example, Kind, Stage
from bayes_aero.parameter import Parameter, Prior


def increments(v, s, a, known):
    """Cm += CmB sin(phi)."""
    return {"Cm": v["CmB"] * jnp.sin(s["phi"])}


EFFECT = Effect(
    name="bank_pitching",
    kind=Kind.AERODYNAMICS,
    stage=Stage.TOTAL,
    claim="Bank pitches the aircraft.",
    parameters=(Parameter("CmB", "1", 0.0, 0.0, "slope", Prior("normal", 0.0, 0.1)),),
    channels=("phi",),
    increments=increments,
    example=Example({"CmB": 0.1}, {"phi": 0.5}, {"Cm": 0.0479}, "0.1 sin 0.5"),
    source="made up",
    sizes={"CmB": (0.005, 0.1)},
)
'''


def own_card(folder, source=SOURCE, active=False):
    """The ATTAS card in another folder, naming a file of effects."""
    (folder / "mine.py").write_text(source)
    effects = 'effects = ["bank_pitching",' if active else "effects = ["
    text = shipped_cards()["attas"].read_text().replace("effects = [", f'effect_files = ["mine.py"]\n{effects}', 1)
    path = folder / "mine.toml"
    path.write_text(text)
    return path


def test_a_card_takes_an_effect_from_its_own_folder(tmp_path, everything):
    card = read_card(own_card(tmp_path, active=True))
    model = Model.from_card(card)
    assert "CmB" in model.names
    assert model.effects == Model.from_card(card).effects  # the same objects: nothing compiles anew
    card = read_card(own_card(tmp_path))
    effects = tuple(own_effects(card.effect_files).values())
    candidates = candidate_model(Model.from_card(card), everything, effects)
    assert "bank_pitching" in {e.name for e in candidates.candidates}
    assert "CmB" in candidates.model.names
    card = read_card(own_card(tmp_path))
    (tmp_path / "mine.py").unlink()
    with pytest.raises(InputError, match=r"mine\.py cannot be read"):
        Model.from_card(card)


@pytest.mark.parametrize(("source", "said"), [
    ("1/0", "does not run: ZeroDivisionError"),
    ("x = (", "does not run: SyntaxError"),
    ("x = 1", "defines no Effect"),
    (SOURCE.replace('"bank_pitching"', '"thrust_lift"'), "the name thrust_lift is taken"),
])  # fmt: skip
def test_a_file_that_is_no_effect_is_said_in_a_sentence(tmp_path, source, said):
    with pytest.raises(InputError, match=said):
        Model.from_card(read_card(own_card(tmp_path, source)))


# Effects with names of their own that declare what their parameters are: they do what the catalogue's do
def gentle(v, _s, _a, known):
    """X = 1/2 - arctan(k (incidence - alpha_half))/pi."""
    return {"X": -0.5 - jnp.arctan(v["k"] * (known["incidence"] - v["alpha_half"])) / jnp.pi}


PRIORS = Prior("lognormal", 30.0, 0.5), Prior("normal", 0.3, 0.1)
ARCTAN_STALL = Effect(
    name="arctan_stall",
    kind=Kind.AERODYNAMICS,
    stage=Stage.SEPARATION,
    claim="The flow separates more gently than with a hyperbolic tangent.",
    parameters=(
        Parameter("k", "1/rad", 30.0, 30.0, "abruptness", PRIORS[0], (1.0, 300.0), role=Role.ABRUPTNESS),
        Parameter("alpha_half", "rad", np.inf, 0.3, "X = 1/2", PRIORS[1], (0.0, 1.0), role=Role.BREAK_ANGLE),
    ),
    channels=("alpha",),
    increments=gentle,
    example=Example({"k": 30.0, "alpha_half": 0.3}, {"alpha": 0.3}, {"X": -0.5}, "half way, by definition"),
    source="our choice of form",
    sizes={"k": (2.0, 80.0), "alpha_half": (0.1, 10.0)},
)


def in_place_of(name, own, card):
    """The card's model with an effect of the user's for one of the catalogue."""
    return Model.of([own if e == name else e for e in card.effects])


def values(**more):
    """The demo's true values, and those of parameters that have names of their own."""
    return {name: jnp.asarray(x) for name, x in (TRUTH | more).items()}


def own_lag(role):
    """The lag of the catalogue as a user would write it: another name."""
    effect = CATALOGUE["separation_lag"]
    (tau1,) = effect.parameters
    return replace(
        effect, name="own_lag", parameters=(replace(tau1, name="T_flow", role=role),),
        increments=lambda v, *given: effect.increments(v | {"tau1": v["T_flow"]}, *given),
        sizes={"T_flow": effect.sizes["tau1"]},
    )  # fmt: skip


PLANT_INPUTS = (
    "time", "stabilizer", "rudder", "spoiler_left", "spoiler_right", "dlc_left", "dlc_right", "flap", "phi", "phi_rate",
    "phi_acceleration", "beta", "beta_dot", "beta_acceleration", "dCL", "dCD", "dCm",
)  # fmt: skip


def rates(model, card, v):
    """Rates of the state at one instant of a stall."""
    zero = jnp.asarray(0.0)
    plant = Plant(model, v, card.aircraft, (jnp.asarray(0.7), jnp.asarray(0.2), zero), zero)
    inputs = dict.fromkeys(PLANT_INPUTS, zero)
    inputs |= {"led_alpha": zero + 0.25, "thrust": zero + 9e3, "command": zero + 0.01}
    return FlightState(*plant.motion(jnp.array(FlightState(80.0, 0.26, 0.2, 0.01, 5000.0, 0.4)), inputs)[0])


def test_a_lag_of_any_name_is_flown_if_it_names_its_time_constant(card, everything):
    own, silent = (in_place_of("separation_lag", own_lag(role), card) for role in (Role.LAG, None))
    usual = Model.of(card.effects)
    v = values(tau1=10.0, T_flow=10.0)
    lagging = rates(usual, card, v)
    assert lagging.lagged_X != 0.0
    np.testing.assert_array_equal(rates(own, card, v), lagging)
    steps = [aircraft_dynamics(m, everything).slowest_step(v, everything) for m in (usual, own)]
    assert steps[0] == steps[1] < np.inf
    with pytest.raises(InputError, match=r"own_lag is a lag .* none of its parameters has the role lag"):
        aircraft_dynamics(silent, everything)


def test_other_laws_of_the_stall_are_flown_beyond_their_own_break_angle(card):
    model = in_place_of("flow_separation", ARCTAN_STALL, card)
    v = values(k=30.0, alpha_half=0.22)
    flown, _, refused = fly_standard(model, v, card.aircraft, Condition(95.0, 5200.0), dt=0.04)
    assert not refused
    assert flown["slow_stall"]["alpha"].max() > 0.22
    assert flown["slow_stall"]["X"].min() < 0.5 < flown["elevator_doublet"]["X"].min()
