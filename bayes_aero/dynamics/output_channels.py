"""What a trajectory is compared with."""

FLIGHT = ("airspeed", "alpha", "theta", "q")
