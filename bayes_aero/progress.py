"""How a long job tells what it does."""

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Is called with a stage in words and the share of it that is done, 0 to 1."""


def quiet(_: str, __: float) -> None:
    """Progress that is not shown."""
