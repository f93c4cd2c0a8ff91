"""Draws of neighbouring views: as alike as asked for, whoever asks first."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.draws import view_rng
from twinct.uncertainty.correlation import view_normals


def test_white_draws_are_those_of_the_view() -> None:
    expected = view_rng(3, "a", 7).normal(size=4)
    np.testing.assert_array_equal(view_normals(3, "a", 7, 4), expected)


def test_draws_are_alike_over_the_length() -> None:
    """Correlation d views apart: exp(-d^2 / 2 length^2), whatever the seed."""
    length, apart = 4.0, (0, 2, 4, 8)
    draws = np.array(
        [[view_normals(seed, "a", 20 + d, 3, length) for d in apart] for seed in range(400)]
    )
    found = np.einsum("sdk,sk->d", draws, draws[:, 0]) / draws[:, 0].size
    # 1200 products of normal draws: standard error at most 0.04
    assert found == pytest.approx(np.exp(-(np.array(apart) ** 2) / (2 * length**2)), abs=0.12)


def test_a_draw_asks_for_no_other_view() -> None:
    one = view_normals(5, "b", 11, 2, 3.0)
    assert not np.array_equal(view_normals(5, "b", 10, 2, 3.0), one)
    np.testing.assert_array_equal(view_normals(5, "b", 11, 2, 3.0), one)
