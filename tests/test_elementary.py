"""Exponential and logarithm of loops that become vectors, against those of the C library."""
import numba
import numpy as np
import pytest

from fe_el.compiled.elementary import exponential, logarithm


@numba.njit
def _values(x, exponentials, logarithms):
    for i in range(len(x)):
        exponentials[i], logarithms[i] = exponential(x[i]), logarithm(abs(x[i]))


def _of(x):
    out = np.empty_like(x), np.empty_like(x)
    _values(x, *out)
    return out


def test_agree_with_the_c_library_to_round_off():
    some = np.random.default_rng(1)
    x = np.concatenate([some.uniform(-690, 690, 20_000), some.uniform(-2, 2, 20_000), 10 ** some.uniform(-300, 2, 20_000),
                        1 + 1e-8 * some.uniform(-1, 1, 1000), [1.0, 2.0, 0.5, np.sqrt(0.5), np.nextafter(1.0, 0.0)]])
    exponentials, logarithms = _of(x)
    assert np.abs(exponentials / np.exp(x) - 1).max() < 1e-15
    assert (np.abs(logarithms - np.log(np.abs(x))) <= 1e-15 * np.abs(np.log(np.abs(x)))).all()


def test_what_is_no_number_stays_so_and_what_is_too_large_stays_finite():
    exponentials, _ = _of(np.array([np.nan, 1e5, -1e5, 0.0]))
    assert np.isnan(exponentials[0]) and np.isfinite(exponentials[1:]).all()
    assert exponentials[3] == 1 and exponentials[2] == pytest.approx(0, abs=1e-300)
