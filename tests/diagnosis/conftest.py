"""What several modules of this folder share: compiled programs, above all."""

import pytest
from parts import with_candidates

from bayes_aero.diagnosis.design import standard

RATES, DRAGS = ("alpha_dot_lift", "pitch_rate_lift"), ("sideslip_drag", "mach_drag")


@pytest.fixture(scope="session")
def state(card, model):
    """Two simulated stalls by the card's model, and candidates that are none of them there."""
    return with_candidates(card, model, (*RATES, *DRAGS), seeds=(0, 1))


@pytest.fixture(scope="session")
def flights(state):
    """The standard manoeuvres with every candidate in the model, at neutral."""
    return standard(state, (*RATES, *DRAGS))
