"""Records of aircraft that nobody here has seen, from a simulator of their own: the hidden effect, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from stranger import HIDDEN, card_text, fly, plane, write

from bayes_aero.criticism.diagnosis import diagnose
from bayes_aero.criticism.finding import Verdict
from bayes_aero.flight.card import read_card
from bayes_aero.flight.readers import read_record

DRAWN = np.random.default_rng(20261).integers(1_000_000, size=2)
SENSORS = ("alpha_scale", "pitch_rate_bias")


def diagnosed(folder, rng, **hidden):
    """Two stalls of a random aircraft that does not leave its envelope, read from CSV and diagnosed."""
    errors = {name: x for name, x in hidden.items() if name in SENSORS}
    for _ in range(10):
        p = plane(rng)
        for name, x in hidden.items():
            if name not in SENSORS:
                p = replace(p, **{name: x * (p.c / 1.58 if name == "thrust_arm" else 1.0)})
        dt = float(rng.choice([0.02, 0.04, 0.05]))
        with np.errstate(invalid="ignore"):
            flights = [fly(p, rng, dt) for _ in range(2)]
        if all(np.all(np.isfinite(x)) and x[2].max() < 0.5 and np.abs(x[3]).max() < 0.9 for x in flights):
            break
    else:
        pytest.fail("no such aircraft could be flown")
    for number, rows in enumerate(flights):
        write(folder / f"run{number}.csv", rows, errors, rng)
    (folder / "card.toml").write_text(card_text(p))
    card = read_card(str(folder / "card.toml"))
    records = [read_record(folder / f"run{number}.csv", card.channels) for number in range(2)]
    return p, diagnose(records, card, seed=int(rng.integers(1000)), gains_wanted=False)


@pytest.mark.recovery
def test_what_was_hidden_is_named_with_its_size(tmp_path):
    rng = np.random.default_rng(DRAWN[0])
    name = str(rng.choice(list(HIDDEN)))
    parameter, least, most = HIDDEN[name]
    size = rng.uniform(least, most) * (
        1.0 if name in ("alpha_dot_moment", "separation_lag") else rng.choice([-1.0, 1.0])
    )
    p, found = diagnosed(tmp_path, rng, **{parameter: float(size)})
    assert [cause.name for cause in found.causes] == [name]
    assert found.verdict is Verdict.EXPLAINED
    truth, estimate = float(getattr(p, parameter, size)), found.causes[0].parameters[parameter]
    assert abs(estimate.mean - truth) < 3.0 * estimate.sd + 0.01 * abs(truth)
    for base, own in (
        ("Cma", p.Cma),
        ("Cmq", p.Cmq / 2.0),
        ("Cmde", p.Cmde),
        ("CLa", p.CLa),
        ("e", p.e),
        ("CDX", p.CDX),
    ):
        assert found.base_moves[base][1] == pytest.approx(own, rel=0.03), base


@pytest.mark.recovery
def test_nothing_is_named_where_nothing_is_hidden(tmp_path):
    _, found = diagnosed(tmp_path, np.random.default_rng(DRAWN[1]))
    assert found.verdict is Verdict.NO_EFFECT
