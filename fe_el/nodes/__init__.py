"""The floor that fluid and smoothing share: nodes of a P1 space, matrices on them, solvers."""
