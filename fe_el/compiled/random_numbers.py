"""Random numbers that are functions of integers: the same on any rank, in any order, and after a restart."""
import math

import numpy as np

from fe_el.compiled.cache import njit


@njit
def scrambled(*words):
    """64 random bits from integers, by splitmix64 (Steele, Lea & Flood 2014)."""
    state = np.uint64(0x9E3779B97F4A7C15)
    for word in words:
        state = (state ^ np.uint64(word)) + np.uint64(0x9E3779B97F4A7C15)
        state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        state ^= state >> np.uint64(31)
    return state


@njit
def uniform(*words):
    """A number from 0 to 1, neither included."""
    return (np.float64(scrambled(*words) >> np.uint64(12)) + 0.5) / 4503599627370496.0


@njit
def normal(a, b, c, d):
    """A number of the normal distribution of variance one."""
    return math.sqrt(-2 * math.log(uniform(a, b, c, d, 0))) * math.cos(2 * math.pi * uniform(a, b, c, d, 1))
