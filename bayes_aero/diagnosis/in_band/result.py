"""Sizes of the causes in a band of frequencies, as plain data."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SizeInBand:
    """A parameter of a cause, SI: in the band, with its standard error, and beside the `mean` and `sd` of the
    coefficients. `apart`: their difference in standard errors of the difference."""

    cause: str
    parameter: str
    unit: str
    in_band: tuple[float, float]
    coefficients: tuple[float, float]
    apart: float


@dataclass(frozen=True)
class CausesInBand:
    """`band` in Hz. `unseen`: parameters of causes that the band does not show; `converged`: whether the fit did."""

    band: tuple[float, float]
    sizes: tuple[SizeInBand, ...]
    unseen: tuple[str, ...]
    converged: bool
