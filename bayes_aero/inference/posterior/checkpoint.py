"""Storage of a growing chain, so that a run that was killed continues where it stopped, with the same chain.

emcee's own HDFBackend opens its file at every step of every ensemble, which takes longer than the steps here, and a
kill while it writes can destroy the file. Here every stretch of steps is a separate file, complete or absent.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Int

from bayes_aero.atomic_write import write_whole
from bayes_aero.errors import InputError

DESCRIPTION, BURN_IN, STEPS = "about.json", "burn_in.npz", "steps_{:08d}.npz"
UNREADABLE = (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile)


@dataclass(frozen=True)
class BurnIn:
    """State between two rounds of the burn-in: positions of the walkers, the proposal, and whether it is finished."""

    begin: Float[np.ndarray, "ensemble walker k"]
    centre: Float[np.ndarray, " k"]
    factor: Float[np.ndarray, "k k"]
    accepted: float
    rounds: int
    over: bool
    rejected: int


@dataclass(frozen=True)
class Stretch:
    """Steps of all ensembles, with counts up to their end and the state of each random generator there."""

    chain: Float[np.ndarray, "ensemble step walker k"]
    log_prob: Float[np.ndarray, "ensemble step walker"]
    accepted: Float[np.ndarray, "ensemble walker"]
    keys: Int[np.ndarray, "ensemble 624"]  # of numpy's MT19937
    places: Float[np.ndarray, "ensemble 3"]  # position, whether a normal number is left over, and that number
    rejected: int

    @property
    def random_states(self) -> list[tuple[str, np.ndarray, int, int, float]]:
        """As `numpy.random.RandomState.set_state` takes them."""
        rows = zip(self.keys.astype(np.uint32), self.places, strict=True)
        return [("MT19937", keys, int(place), int(left), float(number)) for keys, (place, left, number) in rows]

    @classmethod
    def of(cls, chain: np.ndarray, log_prob: np.ndarray, accepted: np.ndarray, states: Any, rejected: int) -> Stretch:
        """From the state of emcee's samplers."""
        keys = np.stack([state[1] for state in states]).astype(np.int64)
        places = np.array([[float(x) for x in state[2:5]] for state in states])
        return cls(chain, log_prob, accepted, keys, places, rejected)


Part = TypeVar("Part", BurnIn, Stretch)


class Checkpoint:
    """A folder of one run: `made_from` are all settings, inputs and versions on which its numbers depend.

    Files of another run are deleted. The files are plain arrays and JSON, no code.
    """

    def __init__(self, folder: Path, made_from: Mapping[str, Any]) -> None:
        self.folder, self.made_from = folder, json.dumps(made_from, sort_keys=True, default=str)

    def begin(self, *arrays: np.ndarray) -> tuple[BurnIn | None, Stretch | None]:
        """Stored burn-in and steps of a run with the same `made_from` and `arrays`; None where there are none."""
        digest = hashlib.sha256(self.made_from.encode())
        for array in arrays:
            digest.update(str(array.shape).encode() + np.ascontiguousarray(array).tobytes())
        identity = digest.hexdigest()
        try:
            known = json.loads((self.folder / DESCRIPTION).read_text(encoding="utf-8")) == {"made_from": identity}
        except UNREADABLE:
            known = False
        if known:
            return _read(self.folder / BURN_IN, BurnIn), self._stored_steps()
        shutil.rmtree(self.folder, ignore_errors=True)
        try:
            self.folder.mkdir(parents=True)
            _write(self.folder / DESCRIPTION, json.dumps({"made_from": identity}).encode())
        except OSError as reason:
            raise InputError(f"cannot write to {self.folder} ({reason.strerror}); give another folder") from None
        return None, None

    def _stored_steps(self) -> Stretch | None:
        """All stored stretches without a gap, joined."""
        parts: list[Stretch] = []
        count = 0
        while (part := _read(self.folder / STEPS.format(count), Stretch)) is not None:
            parts.append(part)
            count += part.chain.shape[1]
        if not parts:
            return None
        chain, log_prob = (np.concatenate([getattr(p, key) for p in parts], axis=1) for key in ("chain", "log_prob"))
        last = parts[-1]
        return Stretch(chain, log_prob, last.accepted, last.keys, last.places, last.rejected)

    def keep_burn_in(self, part: BurnIn) -> None:
        """Store the state of the burn-in."""
        _write(self.folder / BURN_IN, part)

    def keep(self, part: Stretch, before: int) -> None:
        """Store a stretch that follows `before` steps."""
        _write(self.folder / STEPS.format(before), part)

    def remove(self) -> None:
        """Delete the folder of a complete run."""
        shutil.rmtree(self.folder, ignore_errors=True)


def _write(path: Path, content: bytes | BurnIn | Stretch) -> None:
    """Write a file whole or not at all."""
    packed = io.BytesIO(content if isinstance(content, bytes) else b"")
    if not isinstance(content, bytes):
        np.savez(packed, allow_pickle=False, **{f.name: np.asarray(getattr(content, f.name)) for f in fields(content)})
    write_whole(packed.getvalue(), path, flush=True)


def _read(path: Path, kind: type[Part]) -> Part | None:
    """None where the file is absent, damaged or not what it should be."""
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as stored:
            found = {f.name: stored[f.name] for f in fields(kind)}
        return kind(**{name: x.item() if x.ndim == 0 else x for name, x in found.items()})
    except UNREADABLE:
        return None
