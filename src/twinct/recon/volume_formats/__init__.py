"""Files of volumes for other programs: one file of this package for each format."""

from twinct.recon.volume_formats.registry import volume_format_named, volume_formats
from twinct.recon.volume_formats.volume_format import VolumeFacts, VolumeFormat, format_of_name

__all__ = ["VolumeFacts", "VolumeFormat", "format_of_name", "volume_format_named", "volume_formats"]
