"""What several test files need."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.geometry import Panel, Pose, ScanGeometry


@pytest.fixture
def random_pose() -> Callable[[np.random.Generator], Pose]:
    """A maker of poses anywhere within half a metre."""

    def make(rng: np.random.Generator) -> Pose:
        return Pose(rng.uniform(-500, 500, 3), Rotation.random(random_state=rng).as_quat())

    return make


@pytest.fixture
def random_geometry() -> Callable[..., ScanGeometry]:
    """A maker of views all around the origin, with panels tilted and shifted off the beam."""

    def make(
        rng: np.random.Generator, views: int, panel: Panel, tilt_deg: float = 20.0
    ) -> ScanGeometry:
        directions = rng.normal(size=(views, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        sources = directions * rng.uniform(250, 350, (views, 1))
        detectors = -directions * rng.uniform(250, 350, (views, 1)) + rng.uniform(-5, 5, (views, 3))
        axes_u, axes_v = [], []
        for direction in directions:
            other = np.cross(direction, rng.normal(size=3))
            u = other / np.linalg.norm(other)
            tilt = Rotation.from_rotvec(rng.uniform(-1, 1, 3) * np.radians(tilt_deg))
            axes_u.append(tilt.apply(u))
            axes_v.append(tilt.apply(np.cross(direction, u)))
        return ScanGeometry(sources, detectors, np.array(axes_u), np.array(axes_v), panel)

    return make
