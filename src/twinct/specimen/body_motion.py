"""Motion of a grey part over the time of a scan: from the scenario's section to moved voxels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from twinct.core.errors import SpecimenError
from twinct.core.files.nifti import read_nifti
from twinct.core.foreign_text import quoted
from twinct.geometry import Floats, Pose
from twinct.specimen import sections
from twinct.specimen.breathing import (
    Breath,
    Chest,
    Displacement,
    PhaseFields,
    Rhythm,
    require_smooth,
)
from twinct.specimen.deformation import Deformation
from twinct.specimen.displacement_map import Map, map_of
from twinct.specimen.grey import GreyField
from twinct.specimen.grey_part import GreyPart, VoxelLabels
from twinct.specimen.part import Part

if TYPE_CHECKING:
    import trimesh
    from numpy.typing import NDArray

NODES_MM = 6.0
"""Distance of the points between which the simulated displacements are linear."""

CHECKED_PHASES = 8
"""Phases of a usual breath in which folding is looked for."""

FULL = Breath(0.5)
"""The state that says where a patient moves."""

LARGEST_SLIP_MM = 0.1
"""Way of moving tissue at the surface of a part that stands still, which is refused beyond."""

SURFACE_STEP_MM = 10.0
"""Distance of the points at which such a surface is looked at."""


@dataclass(frozen=True, eq=False)
class BodyMotion:
    """Motion of one grey part: its breaths over time, and the displacements of each state.

    Attributes:
        part: name of the part.
        rhythm: course of breathing.
        displacement: displacement of points in the part's frame, of point and state.
        specimen_from_part: pose of that frame.
    """

    part: str
    rhythm: Rhythm
    displacement: Displacement
    specimen_from_part: Pose

    def at(self, time_s: float) -> Breath:
        """Return the state of breathing at a time of the scan."""
        return self.rhythm.at(time_s)

    def scaled(self, amplitude_rel: float) -> BodyMotion:
        """Return the same motion with another amplitude."""
        if amplitude_rel == 1:
            return self
        return replace(self, displacement=_Scaled(self.displacement, amplitude_rel))

    def deformation(self, breath: Breath, world_from_specimen: Pose | None = None) -> Deformation:
        """Return the deformation in a state; without a pose, in the specimen's frame."""
        pose = self.specimen_from_part
        if world_from_specimen is not None:
            pose = world_from_specimen @ pose
        return Deformation(partial(self.displacement, breath=breath), pose)

    def displacements_mm(self, points: Floats, breath: Breath = FULL) -> Floats:
        """Return how far points (n, 3) of the specimen's frame move, (n,), mm."""
        local = self.specimen_from_part.inverse().apply(points)
        return np.linalg.norm(self.displacement(local, breath), axis=1)

    def require_apart(self, name: str, mesh: trimesh.Trimesh) -> None:
        """Check that a part that stands still lies where nothing moves.

        Raises:
            SpecimenError: tissue slides along its surface.
        """
        from trimesh.remesh import subdivide_to_size

        points = subdivide_to_size(mesh.vertices, mesh.faces, SURFACE_STEP_MM, max_iter=20)[0]
        slip = float(self.displacements_mm(points).max())
        if slip > LARGEST_SLIP_MM:
            raise SpecimenError(
                f"specimen.motion: part {quoted(name)} stands still where {quoted(self.part)} "
                f"moves by {slip:.2g} mm (at most {LARGEST_SLIP_MM:g} mm is allowed): a motion "
                "moves the voxels of one grey part, and no mesh"
            )

    def moved(self, part: GreyPart, breath: Breath) -> GreyPart:
        """Return the part in a state of breathing: voxels, labels and skin."""
        field = self.moved_field(part.field, breath)
        labels = part.labels
        if labels:
            values = _pulled_labels(labels.values, self._map(part.field, breath))
            labels = VoxelLabels(labels.names, values)
        mesh = part.mesh.copy()
        mesh.vertices = self.deformation(breath).from_reference(np.asarray(mesh.vertices))
        return replace(part, field=field, labels=labels, mesh=mesh)

    def moved_field(self, field: GreyField, breath: Breath) -> GreyField:
        """Return a field in a state of breathing: each voxel reads where its material was."""
        amounts = np.empty_like(field.amounts)
        self.pull(field, breath, amounts)
        return replace(field, amounts=amounts)

    def pull(self, field: GreyField, breath: Breath, out: NDArray[np.float32]) -> None:
        """Write the amounts of a moved field to ``out``, of the shape of its amounts."""
        from twinct.specimen import _moved_voxels

        _moved_voxels.pull_amounts(field.amounts, *self._map(field, breath), out)

    def _map(self, field: GreyField, breath: Breath) -> Map:
        step = max(1, int(NODES_MM / field.grid.voxel.max()))
        return map_of(self.deformation(breath), field.grid, "to_reference", step)


def _pulled_labels(values: NDArray[np.uint16], at: Map) -> NDArray[np.uint16]:
    from twinct.specimen import _moved_voxels

    out = np.empty_like(values)
    _moved_voxels.pull_labels(values, *at, out)
    return out


@dataclass(frozen=True, eq=False)
class _Scaled:
    """A motion with another amplitude."""

    motion: Displacement
    share: float

    def __call__(self, points: Floats, breath: Breath) -> Floats:
        return self.share * self.motion(points, breath)

    def rests(self, breath: Breath) -> bool:
        return self.motion.rests(breath)


def body_motion(section: sections.Specimen) -> BodyMotion:
    """Return the motion of a specimen that has one.

    Raises:
        SpecimenError: a file of vectors cannot be used.
    """
    motion = section.motion
    assert motion is not None
    rhythm = Rhythm(
        motion.period_s, motion.irregularity, motion.drift_per_min, motion.seed, motion.start_phase
    )
    part = section.moving_part
    if isinstance(motion, sections.Breathing):
        keys = "diaphragm_mm", "front_mm", "hysteresis", "dome_mm", "reach_mm", "half_axes_mm"
        ways: Displacement = Chest(**{name: getattr(motion, name) for name in keys})
    else:
        ways = _read_fields(motion)
    return BodyMotion(part.label, rhythm, ways, part.specimen_from_part)


def _read_fields(section: sections.Fields) -> PhaseFields:
    results: list[NDArray[np.float32]] = []
    affine = np.eye(4)
    for i, one in enumerate(section.phases):
        where = f"specimen.motion.phases.{i}.path: {one.path}"
        values, image = read_nifti(one.path, where, SpecimenError)
        if values.ndim == 5 and values.shape[3] == 1:
            values = values[:, :, :, 0]
        if values.ndim != 4 or values.shape[3] != 3 or min(values.shape[:3]) < 2:
            raise SpecimenError(
                f"{where} has shape {values.shape}; expected vectors (x, y, z, 3) or "
                "(x, y, z, 1, 3), with at least 2 voxels along each axis"
            )
        if not np.isfinite(values).all():
            raise SpecimenError(f"{where} holds values that are not finite")
        at = np.asarray(image.affine, dtype=np.float64)
        if results and (values.shape != results[0].shape or not np.allclose(at, affine, atol=1e-3)):
            raise SpecimenError(f"{where} is on another grid than the first phase")
        affine = at
        results.append(values)
    vectors = np.stack(results).astype(np.float64)
    if section.axes == "lps":
        vectors[..., :2] *= -1
    return PhaseFields(vectors.transpose(0, 3, 2, 1, 4), affine)


def require_possible(motion: BodyMotion, parts: tuple[Part, ...]) -> None:
    """Check that a motion does not fold its part in a usual breath.

    Raises:
        InputError: it does; names phase and place.
    """
    part = next(part for part in parts if part.name == motion.part)
    local = motion.specimen_from_part.inverse().apply(np.asarray(part.mesh.vertices))
    bounds = np.stack([local.min(axis=0), local.max(axis=0)])
    states = [Breath(phase) for phase in np.arange(CHECKED_PHASES) / CHECKED_PHASES]
    require_smooth(motion.displacement, states, bounds, "specimen.motion: the displacement field")
