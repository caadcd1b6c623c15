"""How probably a finished model passes its tolerances: in the manoeuvres flown, and in the next flight."""
