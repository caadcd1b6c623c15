"""The section of a starter card that names the model's effects, those of a stall where the record seems to hold one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from bayes_aero.flight.axes import Axis
from bayes_aero.jobs.card.column_statistics import Guess

ATTACHED = (
    "attached_lift", "elevator_moment", "pitching_moment", "pitch_damping", "profile_drag", "induced_drag",
)  # fmt: skip
STALL = (
    "reattachment_hysteresis", "flow_separation", "separation_lag", "kirchhoff_lift", "separated_drag",
    "separated_moment", "separated_induced_drag",
)  # fmt: skip
LATERAL = (
    "side_force_offset", "sideslip_side_force", "roll_offset", "sideslip_roll", "roll_damping", "yaw_rate_roll",
    "aileron_roll", "yaw_offset", "sideslip_yaw", "roll_rate_yaw", "yaw_damping", "rudder_yaw",
)  # fmt: skip
WINGS = ("roll_rate_incidence", "wing_asymmetry", "wing_lift_difference")
MEASURED = ("ay", "beta", "p", "r", "rudder")
REMARKS = {
    "separated_induced_drag": " # induced_share 0: drag of the attached lift, as published; 1: of the lift that is left"
}
MACH_MOVES, SOUND = 0.05, 330.0  # a change of Mach number that tells its effect, and m/s
ROLLS = np.deg2rad(1.0)  # rad/s of roll rate, in the mean square, that tell the lateral coefficients
STALLED = np.deg2rad(12.0)  # alpha beyond which the record is taken to hold a stall


def comment(words: str) -> str:
    """A TOML comment on one line."""
    return "# " + " ".join("".join(c if c.isprintable() else " " for c in words).split())


def _mach_moves(found: Mapping[str, Guess]) -> bool:
    """Whether a lift slope over Mach number can be told from one over nothing."""
    if "mach" in found:
        return float(np.ptp(found["mach"].si)) > MACH_MOVES
    return "airspeed" in found and float(np.ptp(found["airspeed"].si)) / SOUND > MACH_MOVES


def has_lateral(found: Mapping[str, Guess]) -> bool:
    """Whether the channels of the lateral axis are there: six coefficients can be formed and explained."""
    return all(name in found for name in MEASURED) and (
        "aileron" in found or {"aileron_left", "aileron_right"} <= set(found)
    )


def _rolls(found: Mapping[str, Guess]) -> bool:
    return float(np.nanstd(found["p"].si)) > ROLLS


def model_block(found: Mapping[str, Guess], mach: bool) -> Iterator[str]:
    """Lines of `[model]`: the demo aircraft's effects, as far as the record can tell them; `mach`: it is known."""
    reached = float(found["alpha"].si.max()) if "alpha" in found else 0.0
    stalled = reached > STALLED
    lateral, mark = has_lateral(found), ""
    yield "# bayes-aero effects lists all; diagnose looks for those that are missing."
    yield "[model]"
    if lateral:
        moves = _rolls(found)
        mark = "" if moves else "# "
        yield comment(f"guess: the aircraft {'rolls' if moves else 'hardly rolls'} in this record:")
        yield f'{mark}axes = ["{Axis.LONGITUDINAL}", "{Axis.LATERAL}"]'
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
    if lateral:
        yield "# Side force, rolling and yawing moment, with the axes above:"
        yield from (f'{mark}  "{name}",' for name in LATERAL)
        yield from (f'{mark if stalled else "# "}  "{name}",' for name in WINGS)
    yield "]"
    yield ("" if stalled else "# ") + "fixed = { tau1 = 0.0 } # quasi-steady"
