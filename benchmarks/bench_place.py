"""What a search for better places finds, and what a longer one would.

    python benchmarks/bench_place.py                     # share of the sphere, default cell
    python benchmarks/bench_place.py --longer            # more samples, more directions, more seeds
    python benchmarks/bench_place.py --lbr 0 15 30       # the longest arcs of lbr_iiwa14

Each line is JSON. For ``lbr_iiwa14`` the amplitude of the sinusoid is told in degrees; places are
sought for 190 degrees, stand-off 150 mm, and the longest part about longitude 0 is told of which
every view, 2.5 degrees apart, can be held. The cell is there before.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable

import numpy as np
import trimesh

from twinct.geometry import Floats, Pose, fibonacci_directions
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.reach import Bounds, Holder, TargetPoses, place, poses_of
from twinct.scenario import Cell, Detector, DetectorArm, Motion, SourceArm
from twinct.trajectory import on_sphere

HEAD_SEMI_AXES_MM = (72.0, 90.0, 110.0)
PANEL, MOTION = Detector().panel, Motion(trigger="settled")
ARC_DEG, STEP_DEG = 190.0, 2.5


def builder() -> Callable[[Cell], CellModel]:
    head = trimesh.creation.icosphere(subdivisions=3)
    head.apply_scale(HEAD_SEMI_AXES_MM)
    return lambda cell: build_cell(cell, head, Pose.identity(), PANEL)


def about(directions: Floats) -> TargetPoses:
    return poses_of(directions, 300, 300, np.zeros(3), PANEL)


FIRST = Cell(
    source_arm=SourceArm(base_position_mm=(850.0, 0.0, 0.0), standoff_mm=150.0),
    detector_arm=DetectorArm(base_position_mm=(-850.0, 0.0, 0.0), standoff_mm=150.0),
)
"""The paper's cell."""


def sphere(longer: bool) -> None:
    build, whole = builder(), about(fibonacci_directions(1000))
    print(
        json.dumps({"before": float(Holder(build(FIRST), MOTION).held(whole).mean())}), flush=True
    )
    if longer:
        for name, value in {"IMPROVED": 4, "STEPS": (120.0, 60.0, 30.0, 15.0)}.items():
            setattr(sys.modules[place.__module__], name, value)
    for seed in (1, 2) if longer else (0,):
        poses = about(fibonacci_directions(250 if longer else 150))
        found = place(FIRST, build, MOTION, poses, samples=384 if longer else 128, seed=seed)
        after = float(Holder(build(found.cell), MOTION).held(whole).mean())
        told = {"seed": seed, "after": after, "judged": found.judged, "keys": found.overrides}
        print(json.dumps(told), flush=True)


def wave(amplitude_deg: float, range_deg: float, step_deg: float) -> tuple[Floats, TargetPoses]:
    """Longitudes, deg, and views of a sine of latitude over a range of longitude."""
    longitude = np.arange(-range_deg / 2, range_deg / 2 + 1e-9, step_deg)
    latitude = amplitude_deg * np.sin(2 * np.pi * longitude / range_deg)
    return longitude, about(on_sphere(np.radians(longitude), np.radians(latitude), 1.0))


def lbr(amplitude_deg: float) -> None:
    build = builder()
    cell = Cell(
        source_arm=SourceArm(model="lbr_iiwa14", base_position_mm=(650.0, 0.0, -300.0)),
        detector_arm=DetectorArm(model="lbr_iiwa14", base_position_mm=(-650.0, 0.0, -300.0)),
    )
    bounds = Bounds(
        x_mm=(-900, 900), y_mm=(-900, 900), z_mm=(-800, 200), standoff_mm=(150, 150),
        tool_rotation_deg=(0, 0),
    )  # fmt: skip
    _, poses = wave(amplitude_deg, ARC_DEG, 10.0)
    free = (False, False)
    found = place(cell, build, MOTION, poses, roll_free=free, bounds=bounds, samples=64, seed=0)
    longest = 0.0
    for range_deg in np.arange(100.0, ARC_DEG + 1, 5.0):
        _, poses = wave(amplitude_deg, float(range_deg), STEP_DEG)
        if Holder(build(found.cell), MOTION, roll_free=free, starts=16).held(poses).all():
            longest = float(range_deg)
    told = {"amplitude_deg": amplitude_deg, "searched": float(found.after.mean())}
    print(json.dumps(told | {"longest_deg": longest, "keys": found.overrides}), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--longer", action="store_true")
    parser.add_argument("--lbr", type=float, nargs="*", default=[])
    args = parser.parse_args()
    for amplitude in args.lbr:
        lbr(amplitude)
    if not args.lbr:
        sphere(args.longer)


if __name__ == "__main__":
    main()
