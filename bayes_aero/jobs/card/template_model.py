"""The section of a starter card that names the model's effects, those of a stall where the record seems to hold one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from bayes_aero.jobs.card.column_statistics import Guess

ATTACHED = (
    "attached_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag",
)  # fmt: skip
STALL = (
    "reattachment_hysteresis", "flow_separation", "separation_lag", "kirchhoff_lift", "separated_drag",
    "separated_moment", "separated_induced_drag",
)  # fmt: skip
REMARKS = {
    "separated_induced_drag": " # induced_share 0: drag of the attached lift, as published; 1: of the lift that is left"
}
MACH_MOVES, SOUND = 0.05, 330.0  # a change of Mach number that tells its effect, and m/s
STALLED = np.deg2rad(12.0)  # alpha beyond which the record is taken to hold a stall


def comment(words: str) -> str:
    """A TOML comment on one line."""
    return "# " + " ".join("".join(c if c.isprintable() else " " for c in words).split())


def _mach_moves(found: Mapping[str, Guess]) -> bool:
    """Whether a lift slope over Mach number can be told from one over nothing."""
    if "mach" in found:
        return float(np.ptp(found["mach"].si)) > MACH_MOVES
    return "airspeed" in found and float(np.ptp(found["airspeed"].si)) / SOUND > MACH_MOVES


def model_block(found: Mapping[str, Guess], mach: bool) -> Iterator[str]:
    """Lines of `[model]`: the demo aircraft's effects, as far as the record can tell them; `mach`: it is known."""
    reached = float(found["alpha"].si.max()) if "alpha" in found else 0.0
    stalled = reached > STALLED
    yield "# bayes-aero effects lists all; diagnose looks for those that are missing."
    yield "[model]"
    yield "effects = ["
    for name in ATTACHED[:1]:
        yield f'  "{name}",'
    moves = mach and _mach_moves(found)
    remark = "needs the Mach number" if not mach else "" if moves else "the Mach number hardly moves in this record"
    yield ("" if moves else "# ") + '  "mach_lift",' + (f" # {remark}" if remark else "")
    yield from (f'  "{name}",' for name in ATTACHED[1:])
    said = "alpha was not found, so nobody knows whether a stall is in the record; if one is:"
    yield comment(
        said
        if "alpha" not in found
        else f"guess: alpha reaches {np.rad2deg(reached):.3g} deg, {'beyond' if stalled else 'not'} "
        f"{np.rad2deg(STALLED):.0f} deg, so {'a' if stalled else 'no'} stall is in the record:"
    )
    for name in STALL:
        yield ("" if stalled else "# ") + f'  "{name}",' + REMARKS.get(name, "")
    yield "]"
    yield ("" if stalled else "# ") + "fixed = { tau1 = 0.0 } # quasi-steady"
