"""Models that are exported, and what they give by the package itself."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from bayes_aero.effect import Stage
from bayes_aero.effects import CATALOGUE
from bayes_aero.export.identified import Identified
from bayes_aero.flight.card import read_card
from bayes_aero.model.model import Model
from bayes_aero.physics.aircraft import Axis
from bayes_aero.simulate.demo import LATERAL_EFFECTS, LATERAL_TRUTH, TRUTH

BOTH = (Axis.LONGITUDINAL, Axis.LATERAL)


def stall(tau1: float = 0.0, **changes: object) -> Identified:
    """The demo's aircraft; with a lag of the separation point where `tau1` is not 0."""
    card = read_card("attas")
    model = Model.from_card(card)
    model = model if tau1 == 0.0 else replace(model, fixed=())
    return Identified("stall", card.title, model, card.aircraft, TRUTH | {"tau1": tau1}, ("A test.",), **changes)


def six() -> Identified:
    """The same with lateral motion, a lag, and products of inertia."""
    card = read_card("attas")
    model = Model.of((*card.effects, *LATERAL_EFFECTS), None, BOTH)
    aircraft = replace(card.aircraft, Ixy=1500.0, Iyz=-2000.0, reference_point=(-0.02, 0.0, -0.12))
    return Identified("six", card.title, model, aircraft, TRUTH | LATERAL_TRUTH | {"tau1": 4.0}, ())


def everything(lag: float = 3.0) -> Identified:
    """Every effect of the catalogue that is exported, each with a size of its own; without a `lag` at 0."""
    kept = [e for e in CATALOGUE.values() if e.stage not in (Stage.CHANNEL, Stage.INFLOW) and e.disturbance is None]
    model = Model.of(kept, None if lag else {"tau1": 0.0}, BOTH)
    values = {}
    for effect in kept:
        for k, p in enumerate(effect.parameters):
            size = effect.sizes.get(p.name, (0.1, 0.1))[0]
            values[p.name] = p.start if p.start != p.neutral else p.neutral + (1.0 + 0.1 * k) * size
    aircraft = replace(read_card("attas").aircraft, rate_length=1.6, lateral_length=11.0, lateral_rate_length=10.0)
    aircraft = replace(aircraft, Ixy=9e3, Iyz=-2e4, engine_inclination=0.05)
    assert not [e.name for e in kept if e.parameters and e.absent_in(values)]
    values |= {"tau1": lag}
    return Identified("everything", "all effects", model, aircraft, values, ())


def random_signals(found: Identified, n: int, seed: int = 1) -> dict[str, np.ndarray]:
    """Random flow and controls, SI."""
    rng = np.random.default_rng(seed)
    ranges = {"airspeed": (50.0, 150.0), "mach": (0.15, 0.5), "density": (0.4, 1.2), "thrust": (1e3, 6e4)}
    ranges |= {"alpha": (-0.1, 0.45)}
    return {name: rng.uniform(*ranges.get(name, (-0.2, 0.2)), n) for name in (*found.signals, "density")}


def modelled(found: Identified, signals: dict, points: dict | None = None) -> dict[str, np.ndarray]:
    """The coefficients by the model itself."""
    values = {name: jnp.asarray(x) for name, x in found.values.items()}
    s = {name: jnp.asarray(x) for name, x in signals.items()}
    X = None if points is None else tuple(jnp.asarray(x) for x in points.values())
    X = X if X is None or len(X) > 1 else X[0]
    aircraft = found.model.actual_aircraft(values, found.aircraft)
    flow = found.model.flow(values, s, aircraft, X=X)
    return {name: np.asarray(flow[name]) for name in found.model.coefficients}
