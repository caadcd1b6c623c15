"""The card's channels and the ATTAS files, for the tests of this folder."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from flight_samples import CHANNELS

from bayes_aero.flight.channel import Channel

ATTAS = Path(__file__).parents[2].parent / "shared" / "attas"


@pytest.fixture
def channels() -> tuple[Channel, ...]:
    return CHANNELS


@pytest.fixture
def remap() -> Callable[..., tuple[Channel, ...]]:
    """The card's channels with one of them changed."""

    def change(name: str, **fields: object) -> tuple[Channel, ...]:
        return tuple(replace(c, **fields) if c.name == name else c for c in CHANNELS)

    return change


@pytest.fixture(scope="session")
def attas() -> Path:
    if not (ATTAS / "fAttas_qst01.asc").is_file():
        pytest.skip("the ATTAS records are not in ../shared/attas; the README says where to get them")
    return ATTAS
