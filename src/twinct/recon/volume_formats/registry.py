"""All formats of volumes by name, built in or from extensions."""

from __future__ import annotations

from functools import cache

from twinct.core.extensions import Registry
from twinct.recon.volume_formats.dicom_volume import DICOM
from twinct.recon.volume_formats.metaimage_volume import METAIMAGE
from twinct.recon.volume_formats.nifti_volume import NIFTI
from twinct.recon.volume_formats.tiff_stack import TIFF
from twinct.recon.volume_formats.volume_format import VolumeFormat
from twinct.recon.volume_formats.zarr_volume import ZARR

BUILT_IN = {form.name: form for form in (DICOM, NIFTI, METAIMAGE, TIFF, ZARR)}


@cache
def volume_formats() -> Registry[VolumeFormat]:
    """Return the formats in which volumes are written; they are looked up once per process."""
    return Registry("twinct.volume_formats", VolumeFormat, BUILT_IN)


def volume_format_named(name: str) -> VolumeFormat:
    """Return a format by its name.

    Raises:
        InputError: no format has this name, or the package that offers it is broken.
    """
    return volume_formats().named(name, "volume format")
