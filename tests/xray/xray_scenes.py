"""Specimens and random views for the X-ray tests, and what must come out of them analytically."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from twinct.geometry import Floats, Panel, Pose, ScanGeometry
from twinct.specimen import BuiltPart, Material


@dataclass(frozen=True)
class FixedMaterial:
    """Attenuates the same at every energy."""

    mu: float

    def mu_per_mm(self, energy_kev: float) -> float:
        return self.mu


@dataclass(frozen=True)
class Part:
    name: str
    mesh: trimesh.Trimesh
    material: FixedMaterial
    own_rays: bool = False


@dataclass(frozen=True)
class Parts:
    """What an imager needs of a built specimen."""

    parts: tuple[Part, ...]
    motion: None = None


def body(mesh: trimesh.Trimesh, material: Material) -> BuiltPart:
    """A part with the name of its material."""
    return BuiltPart(material.name, material, mesh)


def specimen(*bodies: tuple[trimesh.Trimesh, float]) -> Parts:
    """Parts of given meshes, mm, and attenuations, 1/mm."""
    return Parts(
        tuple(Part(f"part {i}", mesh, FixedMaterial(mu)) for i, (mesh, mu) in enumerate(bodies))
    )


def sphere(centre: Sequence[float], radius: float, subdivisions: int = 4) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    mesh.apply_translation(centre)
    return mesh


def box(centre: Sequence[float], size: Sequence[float]) -> trimesh.Trimesh:
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(centre)
    return mesh


def front_view(panel: Panel) -> ScanGeometry:
    """Source on +x, panel on -x, columns along +y, rows along +z; magnification 2."""
    return ScanGeometry([[300, 0, 0]], [[-300, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], panel)


def random_pose(rng: np.random.Generator, reach_mm: float) -> Pose:
    return Pose(rng.uniform(-reach_mm, reach_mm, 3), Rotation.random(random_state=rng).as_quat())


def random_view(rng: np.random.Generator, panel: Panel, about: Floats) -> ScanGeometry:
    """A view from anywhere, its panel tilted by up to 35 degrees and shifted off the beam.

    Args:
        rng: where the draws come from.
        panel: the pixel lattice.
        about: point near the middle of the image, (3,), mm.
    """
    beam = rng.normal(size=3)
    beam /= np.linalg.norm(beam)
    source = about + rng.uniform(250, 350) * beam
    centre = about - rng.uniform(250, 350) * beam + rng.uniform(-5, 5, 3)
    x = np.cross(beam, rng.normal(size=3))
    x /= np.linalg.norm(x)
    facing = Rotation.from_matrix(np.stack([x, np.cross(beam, x), beam], axis=1))
    axis = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).apply([1, 0, 0])
    tilt = Rotation.from_rotvec(np.radians(rng.uniform(5, 35)) * axis)
    spin = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi))
    axes = (facing * tilt * spin).as_matrix()
    return ScanGeometry(source[None], centre[None], axes[None, :, 0], axes[None, :, 1], panel)


def chords(view: ScanGeometry, centre: Sequence[float], radius: float) -> Floats:
    """Length of each pixel's ray inside a sphere, (rows, columns), mm."""
    rays = view.pixel_centres(0) - view.source[0]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    to_centre = np.asarray(centre) - view.source[0]
    along = rays @ to_centre
    squared = radius**2 - (to_centre @ to_centre - along**2)
    return 2 * np.sqrt(np.maximum(squared, 0.0))
