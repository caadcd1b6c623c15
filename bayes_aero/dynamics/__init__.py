"""Equations of motion, their integration and sensitivities, standard manoeuvres."""
