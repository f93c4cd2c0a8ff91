"""The specimen: bodies, materials, and the true voxel volume."""

from twinct.specimen.build import BuiltPart, BuiltSpecimen, build_specimen
from twinct.specimen.grey import GreyField
from twinct.specimen.grey_part import GreyPart, VoxelLabels
from twinct.specimen.materials import Material, material, material_names
from twinct.specimen.part import Part
from twinct.specimen.size import SpecimenSize, specimen_size
from twinct.specimen.voxels import volume_fractions

__all__ = [
    "BuiltPart",
    "BuiltSpecimen",
    "GreyField",
    "GreyPart",
    "Material",
    "Part",
    "SpecimenSize",
    "VoxelLabels",
    "build_specimen",
    "material",
    "material_names",
    "specimen_size",
    "volume_fractions",
]
