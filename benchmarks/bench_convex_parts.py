"""Convex bodies of concave solids: number, volume, largest gap and time, over the concavity.

    python benchmarks/bench_convex_parts.py

The solids are a C-arm (arc of 200 deg, 100 mm thick, radius 600 mm), a bracket of two plates, the
walls of a room, and the skins of the head and the chest phantom. A line with concavity inf is the
one convex hull; one with 0 has the concavity that scenarios get.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np
import trimesh
from shapely.geometry import Polygon

from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario
from twinct.specimen.convex_parts import convex_parts, fit_of

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def solids() -> dict[str, trimesh.Trimesh]:
    """Return the solids by name, mm."""
    angle = np.radians(np.linspace(0, 200, 60))
    ring = [600 * np.array([np.cos(a), np.sin(a)]) for a in angle]
    ring += [500 * np.array([np.cos(a), np.sin(a)]) for a in angle[::-1]]
    wall = trimesh.creation.box((200, 20, 200)).apply_translation((0, -90, 90))
    plate = trimesh.creation.box((200, 200, 20))
    outside = trimesh.creation.box((6000, 5000, 3000))
    inside = trimesh.creation.box((5800, 4800, 2900)).apply_translation((0, 0, -50))
    door = trimesh.creation.box((1200, 1000, 2100)).apply_translation((0, 2400, -450))
    skins = {
        name: SimulationBuilder(load_scenario(SCENARIOS / file)).specimen.mixtures[0].mesh
        for name, file in (("head", "patient_head.yaml"), ("chest", "patient_breathing.yaml"))
    }
    return {
        "C-arm": trimesh.creation.extrude_polygon(Polygon(ring), 100),
        "bracket": trimesh.boolean.union([plate, wall]),
        "room": trimesh.boolean.difference([outside, inside, door]),
        **skins,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--concavity", type=float, metavar="MM", nargs="+", default=[np.inf, 0.0, 40.0, 20.0, 10.0]
    )
    parser.add_argument("--solids", nargs="+", help="names of solids; all by default")
    told = parser.parse_args()
    concavities = told.concavity
    print("solid     concavity  bodies  volume  gap mm  seconds")
    with tempfile.TemporaryDirectory() as empty:
        os.environ["XDG_CACHE_HOME"] = empty
        for name, mesh in solids().items():
            if told.solids and name not in told.solids:
                continue
            for concavity in concavities:
                start = perf_counter()
                whole = np.isinf(concavity)
                bodies = (mesh.convex_hull,) if whole else convex_parts(mesh, concavity or None)
                fit, seconds = fit_of(mesh, bodies), perf_counter() - start
                print(
                    f"{name:9} {concavity:9g} {fit.bodies:7} {fit.volume:7.3f} {fit.gap_mm:7.1f} "
                    f"{seconds:8.1f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
