"""What all file formats share: a column as it was found, and the search for the columns that a card names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from bayes_aero.errors import InputError
from bayes_aero.flight.channel import Channel

__all__ = ["MAX_VALUES", "MOST_VALUES_IN_ALL", "Column", "foreign", "located", "refuse_huge", "vector"]

MAX_VALUES = 20_000_000
"""Most samples that one channel may have; held against the file's header before memory is taken."""


MOST_VALUES_IN_ALL = 100_000_000
"""Most samples of all channels together: 0.8 GB. A compressed file of some kB can claim any number."""

MOST_HEADINGS = 2000
"""Most columns of a file; searching for a name among millions would take hours."""


@dataclass(frozen=True)
class Column:
    """One channel as in the file: (n,) values in the file's unit, and that unit where the file states it."""

    values: np.ndarray
    unit: str | None = None


def located(channels: Sequence[Channel], available: Sequence[str], kind: str) -> list[Channel]:
    """The channels whose heading is among `available`; a required one must be, and none may be twice."""
    if len(available) > MOST_HEADINGS:
        raise InputError(f"it has {len(available)} {kind}s, more than {MOST_HEADINGS}; is it a flight record?")
    found = []
    for channel in channels:
        count = available.count(channel.heading)
        if count > 1:
            raise InputError(
                f"channel {channel.name}: {count} {kind}s are called {channel.heading!r}; rename all but the right one"
            )
        if count == 1:
            found.append(channel)
        elif channel.required:
            raise InputError(_absent(channel, available, kind))
    return found


def _absent(channel: Channel, available: Sequence[str], kind: str) -> str:
    folded = {name.casefold(): name for name in available}
    close = [folded[name] for name in get_close_matches(channel.heading.casefold(), folded, n=3, cutoff=0.5)]
    if close:
        hint = "did you mean " + " or ".join(repr(name) for name in close) + "?"
    elif available:
        more = ", ..." if len(available) > 15 else ""
        hint = f"the file has {', '.join(repr(name[:40]) for name in available[:15])}{more};"
    else:
        hint = "the file has none at all;"
    return (
        f"channel {channel.name}: no {kind} is called {channel.heading!r}; {hint} "
        f"correct its label on the card, or set required = false"
    )


def refuse_huge(channel: Channel, size: float, channels: int) -> None:
    """Hold what a header claims for one of so many `channels` against what a record can have."""
    if size > MAX_VALUES:
        raise InputError(
            f"channel {channel.name} ({channel.heading!r}) claims {size:.0f} samples, more than {MAX_VALUES}; "
            f"is the file damaged? Write it again"
        )
    if size * channels > MOST_VALUES_IN_ALL:
        raise InputError(
            f"{channels} channels of {size:.0f} samples, as {channel.name} ({channel.heading!r}) claims, are more than "
            f"{MOST_VALUES_IN_ALL} values; is the file damaged? Otherwise cut the record"
        )


def vector(values: np.ndarray, name: str) -> np.ndarray:
    """A numeric array as a float64 vector; row and column vectors are flattened."""
    if values.dtype.kind not in "fiub":
        raise InputError(
            f"channel {name} holds {values.dtype} where numbers should be; store it as plain numbers, "
            f"and time as seconds"
        )
    if values.size > MAX_VALUES:
        raise InputError(f"channel {name} claims {values.size} samples, more than {MAX_VALUES}; cut the record")
    if values.ndim != 1 and values.size != max(values.shape, default=1):
        raise InputError(f"channel {name} has shape {values.shape} where one value a sample should be; split it up")
    return values.astype(np.float64).reshape(-1)


@contextmanager
def foreign(kind: str) -> Iterator[None]:
    """Turn whatever a foreign parser throws at a damaged file into one sentence.

    Such parsers raise anything from KeyError to zlib.error and RecursionError, so this border catches them
    all.
    """
    try:
        yield
    except InputError:
        raise
    except MemoryError as reason:
        raise InputError(
            f"it claims more data than there is memory for; is it damaged? Write the {kind} again"
        ) from reason
    except Exception as reason:
        said = " ".join(str(reason).split())[:120] or type(reason).__name__
        raise InputError(f"it is not a readable {kind} ({said}); is it damaged or misnamed? Write it again") from reason
