"""Mass, inertia, centre of gravity."""
