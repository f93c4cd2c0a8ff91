"""MuJoCo's distances between shapes, against a library that shares no code with it.

Before 3.12, ``mj_geomDistance`` returned 0 for separated shapes:
https://github.com/google-deepmind/mujoco/issues/3383.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from coal_distances import COAL_M, CoalDistances

SCENES, SHAPES = 60, 8
SHAPES_OF = mujoco.mjtGeom
PLAIN = (
    *(SHAPES_OF.mjGEOM_BOX, SHAPES_OF.mjGEOM_SPHERE, SHAPES_OF.mjGEOM_CAPSULE),
    *(SHAPES_OF.mjGEOM_CYLINDER, SHAPES_OF.mjGEOM_ELLIPSOID),
)
OVERLAP_M = 1e-4
"""Shapes that overlap by less may be separated to the other library."""


def scene(rng: np.random.Generator) -> mujoco.MjModel:
    """Shapes of all kinds, anywhere and turned anyhow; the last one is a mesh."""
    spec: Any = mujoco.MjSpec()
    for kind in rng.integers(0, len(PLAIN), SHAPES - 1):
        body = spec.worldbody.add_body(pos=rng.uniform(-1, 1, 3), quat=rng.normal(size=4))
        body.add_geom(type=PLAIN[kind], size=rng.uniform(0.02, 0.3, 3))
    spec.add_mesh(name="mesh", uservert=rng.uniform(-0.3, 0.3, 90))
    body = spec.worldbody.add_body(pos=rng.uniform(-1, 1, 3), quat=rng.normal(size=4))
    body.add_geom(type=SHAPES_OF.mjGEOM_MESH, meshname="mesh")
    return spec.compile()


def test_separated_shapes_of_all_kinds_are_as_far_apart_as_coal_says() -> None:
    rng, apart, overlapping = np.random.default_rng(1), 0, 0
    for _ in range(SCENES):
        model = scene(rng)
        data, referee = mujoco.MjData(model), CoalDistances(model)
        mujoco.mj_kinematics(model, data)
        for a in range(SHAPES):
            for b in range(a):
                wanted = referee.between(data, a, b)
                found = mujoco.mj_geomDistance(model, data, a, b, 10.0, None)
                if wanted > 0:
                    assert abs(found - wanted) < COAL_M, (a, b, found, wanted)
                    apart += 1
                elif wanted < -OVERLAP_M:
                    assert found <= 0, (a, b, found, wanted)
                    overlapping += 1
    assert apart > 1000 and overlapping > 50
