"""Line integrals through voxels against those through the same bodies as meshes.

    python benchmarks/bench_voxels.py skull        # the built-in skull at 2, 1 and 0.5 mm
    python benchmarks/bench_voxels.py skull --sharp
    python benchmarks/bench_voxels.py surface      # the surface in these voxels
    python benchmarks/bench_voxels.py rod          # titanium in a grey body, at 1 and 0.5 mm

Voxels hold volume fractions. The meshes are those of the engine ``mesh``, whose path lengths are
exact. Views are random: from any side, with tilted panels. With ``--sharp``, each point is bone or
nothing (``edges: sharp``), else the fractions are linear between the centres of voxels.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.specimen import BuiltPart, GreyField, GreyPart, build_specimen
from twinct.specimen.materials import Material, material
from twinct.specimen.voxels import volume_fractions
from twinct.xray.paths import PathRenderer

if TYPE_CHECKING:
    import trimesh

PANEL = Panel(240, 320, 1.0, 1.0)
MARGIN = 2
"""Empty voxels around a body."""


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("what", choices=("skull", "surface", "rod"))
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--finest", type=float, default=0.5, help="smallest voxel of the skull")
    parser.add_argument("--sharp", action="store_true", help="sharp edges of the voxels")
    options = parser.parse_args()
    rng = np.random.default_rng(20261126)
    views = [random_view(rng) for _ in range(options.views)]
    if options.what == "rod":
        return rod(views)
    if options.what == "surface":
        return surfaces(views, options.finest)
    skull(views, options.finest, options.sharp)


def skull(views: list[ScanGeometry], finest: float, sharp: bool) -> None:
    """Compare the built-in skull as voxels with its mesh."""
    from twinct import scenario

    section = scenario.Specimen.model_validate({"parts": [{"shape": {"kind": "skull"}}]})
    mesh, bone = build_specimen(section).parts[0].mesh, material("bone")
    exact = lines_of(mesh, views)
    for voxel in (one for one in (2.0, 1.0, 0.5) if one >= finest):
        part = voxels({bone: [(mesh, 1.0)]}, mesh, voxel)
        part = replace(part, field=replace(part.field, sharp=sharp))
        with PathRenderer([part], PANEL) as renderer:
            errors = [
                errors_of(renderer.render(view, Pose.identity())[0], lengths)
                for view, lengths in zip(views, exact, strict=True)
            ]
        rms, means = np.array(errors).T
        print(
            f"voxels of {voxel:g} mm: RMS {np.sqrt((rms**2).mean()):.3f} mm, mean path "
            f"{means.mean():.1f} mm: {100 * np.sqrt((rms**2).mean()) / means.mean():.2f} % "
            f"(single views {100 * (rms / means).min():.2f} to {100 * (rms / means).max():.2f} %)"
        )


def surfaces(views: list[ScanGeometry], finest: float) -> None:
    """Compare surfaces at half the volume fraction of voxels, as ``kind: ct`` has them."""
    from twinct import scenario
    from twinct.specimen.surface import isosurface

    section = scenario.Specimen.model_validate({"parts": [{"shape": {"kind": "skull"}}]})
    mesh, bone = build_specimen(section).parts[0].mesh, material("bone")
    exact = lines_of(mesh, views)
    for voxel in (one for one in (2.0, 1.0, 0.5) if one >= finest):
        field = voxels({bone: [(mesh, 1.0)]}, mesh, voxel).field
        again = isosurface(field.amounts[..., 0].transpose(2, 1, 0), 0.5, field.grid.affine)
        pairs = zip(lines_of(again, views), exact, strict=True)
        rms, means = np.array([errors_of(lines, right) for lines, right in pairs]).T
        print(
            f"voxels of {voxel:g} mm, {len(again.faces)} triangles: RMS "
            f"{np.sqrt((rms**2).mean()):.3f} mm, "
            f"{100 * np.sqrt((rms**2).mean()) / means.mean():.2f} % of the mean path",
            flush=True,
        )


def lines_of(mesh: trimesh.Trimesh, views: list[ScanGeometry]) -> list[NDArray[np.float32]]:
    """Return the path lengths of a mesh."""
    with PathRenderer(
        [BuiltPart("skull", material("bone"), mesh)], PANEL, engine="mesh"
    ) as renderer:
        return [renderer.render(view, Pose.identity())[0] for view in views]


def errors_of(
    lengths: NDArray[np.float32], exact: NDArray[np.float32]
) -> tuple[np.floating, np.floating]:
    """Return the RMS error and the mean over the rays that hit the mesh."""
    hit = exact > 0
    return np.sqrt(np.mean((lengths - exact)[hit] ** 2, dtype=np.float64)), exact[hit].mean()


def rod(views: list[ScanGeometry]) -> None:
    """Compare a titanium rod in a body of voxels with the same bodies as meshes."""
    import trimesh

    titanium, water, bone = (material(name) for name in ("titanium", "water", "bone"))
    body = trimesh.creation.icosphere(subdivisions=6, radius=60.0)
    inner = trimesh.creation.icosphere(subdivisions=6, radius=25.0)
    inner.apply_translation([20.0, 0.0, 0.0])
    metal = trimesh.creation.cylinder(3.0, 70.0, sections=64)
    metal.apply_transform(trimesh.transformations.rotation_matrix(0.7, [1.0, 0.3, 0.2]))
    metal.apply_translation([10.0, 5.0, -3.0])
    mus = {m: m.mu_per_mm(70.0) for m in (titanium, water, bone)}
    solids = [(metal, titanium, 1), (body, water, 1), (inner, water, -1), (inner, bone, 0.6)]
    bodies = [BuiltPart(substance.name, substance, mesh) for mesh, substance, _ in solids]
    with PathRenderer(bodies[:1], PANEL, engine="mesh") as renderer:
        of_rod = [renderer.render(view, Pose.identity())[0] for view in views]
    exact = np.array(lines_of_meshes(views, solids, metal, mus))
    largest = mus[titanium] * max(lengths.max() for lengths in of_rod)
    for voxel in (1.0, 0.5):
        mixtures = {water: [(body, 1.0), (inner, -1.0)], bone: [(inner, 0.6)]}
        part = voxels(mixtures, body, voxel).without([metal])
        with PathRenderer([*bodies[:1], part], PANEL, engine="mesh") as renderer:
            mu = np.array([mus[m] for m in renderer.materials])
            seen = [np.tensordot(mu, renderer.render(v, Pose.identity()), 1) for v in views]
        error = np.sqrt(np.mean((np.array(seen) - exact) ** 2))
        hit = np.array(of_rod) > 0
        near = np.sqrt(np.mean((np.array(seen) - exact)[hit] ** 2))
        print(
            f"voxels of {voxel:g} mm: RMS {100 * error / largest:.2f} % of the rod's largest line "
            f"integral ({largest:.2f}); {100 * near / largest:.2f} % over the rays that hit it"
        )


def lines_of_meshes(
    views: list[ScanGeometry],
    solids: list[tuple[trimesh.Trimesh, Material, float]],
    metal: trimesh.Trimesh,
    mus: dict[Material, float],
) -> list[NDArray[np.float64]]:
    """Return line integrals of nested meshes, the volume of the metal counted once."""
    import trimesh

    total = [np.zeros(PANEL.shape) for _ in views]
    for mesh, substance, weight in solids:
        hollow = mesh if mesh is metal else trimesh.boolean.difference([mesh, metal])
        with PathRenderer(
            [BuiltPart(substance.name, substance, hollow)], PANEL, engine="mesh"
        ) as renderer:
            for lines, view in zip(total, views, strict=True):
                lines += weight * mus[substance] * renderer.render(view, Pose.identity())[0]
    return total


def voxels(
    mixtures: dict[Material, list[tuple[trimesh.Trimesh, float]]],
    skin: trimesh.Trimesh,
    voxel: float,
) -> GreyPart:
    """Return a grey part of the volume fractions of weighted meshes."""
    low, high = skin.bounds
    count = np.ceil((high - low) / voxel).astype(int) + 2 * MARGIN
    pose = Pose((low + high) / 2, np.array([0.0, 0.0, 0.0, 1.0]))
    grid = VolumeGrid(tuple(int(n) for n in count[::-1]), voxel, pose)
    amounts = np.zeros((*grid.shape, len(mixtures)), np.float32)
    for m, meshes in enumerate(mixtures.values()):
        share = np.zeros(grid.shape, np.float32)
        for mesh, weight in meshes:
            faces = np.array(mesh.faces, np.int64)
            corners = np.asarray(mesh.vertices)
            volume_fractions(corners, faces, grid, Pose.identity(), weight=weight, out=share)
        amounts[..., m] = np.maximum(share, 0)
    field = GreyField(tuple(mixtures), amounts, grid)
    return GreyPart("voxels", field.materials[0], skin, field)


def random_view(rng: np.random.Generator) -> ScanGeometry:
    """Return a view from any side, its panel tilted by up to 20 degrees."""
    turn = Rotation.random(random_state=rng)
    tilt = Rotation.from_rotvec(np.radians(rng.uniform(0, 20)) * np.array([1.0, 0.0, 0.0]))
    u, v, normal = (turn * tilt).as_matrix().T
    away = turn.as_matrix()[:, 2]
    return ScanGeometry(350 * away[None], -250 * away[None], u[None], v[None], PANEL)


if __name__ == "__main__":
    main()
