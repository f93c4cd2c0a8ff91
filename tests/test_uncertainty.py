"""Believed poses: the distribution of docs/paper.md, keyed by seed and view alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi, norm, truncnorm

from twinct.geometry import Pose
from twinct.scenario import Uncertainty
from twinct.uncertainty import believed_poses


def offsets(seed: int, views: range) -> np.ndarray:
    still = Pose.from_euler([10, 20, 30], [5, 6, 7])
    pairs = [believed_poses(still, still, Uncertainty(), seed, view) for view in views]
    assert all(np.array_equal(pose.quat, still.quat) for pair in pairs for pose in pair)
    return np.array([[p.position - still.position for p in pair] for pair in pairs])


def test_noise_is_the_truncated_normal_of_the_paper() -> None:
    draws = offsets(1, range(4000)).ravel()
    assert np.abs(draws).max() <= 0.15
    law = truncnorm(-1.5, 1.5, scale=0.1)
    # 24,000 draws: the standard error of the spread is 0.4 %, of the mean 0.0005 mm
    assert draws.std() == pytest.approx(law.std(), rel=0.02)
    assert abs(draws.mean()) < 0.002


def test_what_the_page_says_of_the_noise() -> None:
    """Redrawing narrows each axis; distances still pass the cut-off, which is one of each axis."""
    cut = 1.5  # sigmas
    per_axis = truncnorm(-cut, cut, scale=0.1).std()
    # The ball of the cut-off's radius lies inside its cube, where the density is the normal one.
    inside_cube = (norm.cdf(cut) - norm.cdf(-cut)) ** 3
    beyond = 1 - chi(3).cdf(cut) / inside_cube
    page = (Path(__file__).parents[1] / "docs" / "paper.md").read_text(encoding="utf-8")
    assert f"{per_axis:.3f} mm" in page
    assert f"{100 * beyond:.0f} %" in page
    distances = np.linalg.norm(offsets(2, range(4000)), axis=-1).ravel()
    # 8,000 draws: the standard error of the share is 0.005
    assert (distances > 0.15).mean() == pytest.approx(beyond, abs=0.02)


def test_a_draw_depends_on_seed_and_view_alone() -> None:
    np.testing.assert_array_equal(offsets(1, range(5))[3], offsets(1, range(3, 4))[0])
    assert not np.array_equal(offsets(1, range(1)), offsets(2, range(1)))
    pair = offsets(1, range(1))[0]
    assert not np.array_equal(pair[0], pair[1]), "source and detector draw apart"
