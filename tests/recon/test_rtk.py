import numpy as np
import pytest

from twinct.geometry import Panel
from twinct.recon import Projector, rtk_sart, sart

pytest.importorskip("itk", reason="needs the extra rtk")

AGREEMENT = 0.05
"""RMS difference relative to the RMS of the volume: other border rules, the same lines."""


def test_rtk_gives_the_same_volume_in_the_same_place(random_geometry, turned_grid):
    A = Projector(
        random_geometry(12, Panel(51, 53, 1.9, 1.8), np.random.default_rng(0)), turned_grid
    )
    truth = np.zeros(A.domain_shape, np.float32)
    truth[4:8, 16:22, 4:9] = 1.0
    truth[11:16, 6:11, 13:18] = 0.5
    p = A(truth)
    order = [int(view) for view in np.random.default_rng(1).permutation(12)]
    ours = sart(A, p, iterations=2, relaxation=0.3, order=order)
    theirs = rtk_sart(p, A.geometry, A.grid, iterations=2, relaxation=0.3, order=order)
    inner = (slice(2, -2),) * 3
    difference = np.sqrt(np.mean((ours - theirs)[inner] ** 2))
    assert difference < AGREEMENT * np.sqrt(np.mean(ours[inner] ** 2))
