"""The checker that every test runs under refuses what does not fit its annotation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pytest
from beartype.roar import BeartypeCallHintViolation
from jaxtyping import Float
from typechecker import check_once

from bayes_aero.physics.filters import smooth

if TYPE_CHECKING:
    from nowhere import Anything

N, M = np.zeros(3), np.zeros(4)


@check_once
def both(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"], scale: float = 1.0) -> Float[np.ndarray, " n"]:
    return np.concatenate([x, y]) if scale < 0.0 else scale * (x + y)


@check_once
def unknown(x: Anything, n: int) -> int:
    return x if n else n


@check_once
@dataclass
class Pair:
    x: Float[np.ndarray, " n"]
    y: Float[np.ndarray, " n"]


def test_what_fits_passes_and_an_int_stands_for_a_float():
    assert both(N, N, 2).shape == (3,)
    assert both(M, M).shape == (4,)  # a letter means another size at the next call
    assert Pair(N, y=N).x is N
    assert unknown("x", 0) == 0


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: both(N, M),
        lambda: both(N, N, "1"),
        lambda: both(N, np.zeros((3, 1))),
        lambda: both(N, np.zeros(3, dtype=int)),
        lambda: both(N, N, -1.0),  # the result is twice as long
        lambda: Pair(N, M),
        lambda: unknown(1, "1"),
        lambda: unknown("one", 1),
    ],
)
def test_what_does_not_fit_is_refused(wrong):
    with pytest.raises(BeartypeCallHintViolation):
        wrong()


def test_the_package_is_checked():
    with pytest.raises(BeartypeCallHintViolation):
        smooth("no signal", 0.1)
