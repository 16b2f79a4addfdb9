"""Checks of numbers that users give."""
import numpy as np


def require_positive(name, value):
    """Raise ``ValueError`` unless every value is finite and positive."""
    value = np.asarray(value, float)
    if value.size and not (np.isfinite(value).all() and value.min() > 0):
        worst = value.ravel()[~(np.isfinite(value.ravel()) & (value.ravel() > 0))][0]
        raise ValueError(f"The {name} is {worst:g}; it must be finite and greater than zero.")
