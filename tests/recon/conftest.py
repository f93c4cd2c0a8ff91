import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid


@pytest.fixture
def random_geometry():
    def make(views, panel, rng, sod=100.0, odd=80.0, tilt=0.3):
        rows = []
        for _ in range(views):
            beam = Rotation.random(random_state=rng).as_matrix()
            tilted = beam @ Rotation.from_rotvec(rng.uniform(-tilt, tilt, 3)).as_matrix()
            shift = rng.normal(size=3) * 3
            rows.append((sod * beam[:, 2], shift - odd * beam[:, 2], tilted[:, 0], tilted[:, 1]))
        return ScanGeometry(*(np.array(column) for column in zip(*rows, strict=True)), panel)

    return make


@pytest.fixture
def turned_grid():
    return VolumeGrid((20, 26, 23), (1.3, 1.0, 1.7), Pose.from_euler((3, -2, 1), (20, -30, 50)))


@pytest.fixture
def panel():
    return Panel(31, 37, 2.3, 1.9)
