"""Equations of motion of an aircraft model of effects, in three and in six degrees of freedom."""
