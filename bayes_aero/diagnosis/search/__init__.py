"""The searches for missing effects: in coefficients, in trajectories, in innovations; and what each has found."""
