"""The flight path of recorded accelerations and rates, and the errors of their sensors."""
