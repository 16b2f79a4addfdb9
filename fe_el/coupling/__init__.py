"""The coupling: particles to cell fields, and the forces back to particles."""
