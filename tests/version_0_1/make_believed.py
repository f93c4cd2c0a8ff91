"""Made believed.npz with the sources of version 0.1 (bec5bd8): the poses of ten demo scans.

    PYTHONPATH=OLD/src python make_believed.py OLD/scenarios/demo.yaml believed.npz

Each seed is an acquisition of its own, whose images alone are left out: no pose depends on them.
"""

import sys
from typing import Any

import numpy as np

from twinct.scan import SimulationBuilder, acquire
from twinct.scenario import load_scenario

SEEDS = range(10)


class WithoutImages:
    """A rig that moves as version 0.1 does, in one process."""

    def __init__(self, builder):
        self._robots = builder.robots()

    def move(self, view, target):
        return self._robots.move(target)

    def expose(self, view):
        return None


def seven(pose):
    return [*pose.position, *pose.quat]


def scan(seed):
    """Executed and believed poses, (views, 2, 7), joints, (views, 12), and their names."""
    builder = SimulationBuilder(load_scenario(sys.argv[1], [f"seed={seed}"]))
    views, names = [], []

    def keep(_, view, reached):
        views.append(view)
        names[:] = reached.joint_names

    of_then: Any = acquire  # which takes other arguments than today's
    of_then(WithoutImages(builder), builder.scenario, builder.targets, keep)
    poses = [[[seven(p) for p in pair] for pair in (v.executed, v.believed)] for v in views]
    executed, believed = np.array(poses).swapaxes(0, 1)
    return executed, believed, np.array([v.joints for v in views]), names


scans = [scan(seed) for seed in SEEDS]
executed, _, joints, names = scans[0]
for other in scans:
    assert (other[0] == executed).all() and (other[2] == joints).all()
    assert (other[1][..., 3:] == executed[..., 3:]).all()  # orientations are exact
positions = np.array([believed[..., :3] for _, believed, _, _ in scans])
np.savez_compressed(
    sys.argv[2], executed=executed, joints=joints, joint_names=names, believed_mm=positions
)
