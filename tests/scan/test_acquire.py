"""Acquisition through any rig, and what the poses depend on that are believed of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, Reached
from twinct.scan import Scan, acquire
from twinct.scenario import parse_scenario


class Still:
    """A rig whose arms are where they were told, and whose images are black."""

    def move(self, view: int, target: PosePairs) -> Reached:
        nothing = np.zeros(1)
        return Reached(
            replace(target, object=(Pose.identity(),)),
            ("source_a",),
            *(nothing, nothing, nothing, nothing),
            time_s=view,
            clearance_mm=1.0,
        )

    def expose(self, view: int) -> np.ndarray:
        return np.zeros((2, 2), np.float32)

    def close(self) -> None:
        pass


def believed(seed: int, of_noise: int | None) -> list[tuple[float, ...]]:
    scenario = parse_scenario(
        {
            "seed": seed,
            "trajectory": {"kind": "circle", "views": 2},
            "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 9}}]},
            "uncertainty": {"seed": of_noise},
        }
    )
    turn = Pose.identity().quat
    target = PosePairs.at(*(Pose(np.array([x_mm, 0, 0]), turn) for x_mm in (300, -300)))
    views: list[tuple[np.ndarray, Reached]] = []
    acquire(Still(), [target] * 2, lambda _, *view: views.append(view))
    poses = PosePairs.joined([target] * 2)
    scan = Scan.from_views(scenario, poses, *zip(*views, strict=True))
    return [tuple(pose.position) for view in range(2) for pose in scan.believed[view]]


def test_the_noise_of_the_poses_may_have_a_seed_of_its_own() -> None:
    assert believed(1, None) == believed(2, 1) == believed(1, 1)
    assert believed(1, None) != believed(1, 2)
