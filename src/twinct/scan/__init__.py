"""Acquisition: the rig protocol, the rig in one process, the scan and its store."""

from twinct.scan.acquire import Stopwatch, acquire, never
from twinct.scan.builder import SimulationBuilder
from twinct.scan.damage import frame_damage, unknown_files, view_damage
from twinct.scan.data import Scan, View
from twinct.scan.integrals import line_integrals
from twinct.scan.layout import image_digests, write_frame
from twinct.scan.named_geometries import (
    OWN,
    RELATIVE,
    NamedGeometry,
    checked_name,
    free_geometry_name,
    named_geometries,
    store_geometries,
)
from twinct.scan.provenance import Imported, Provenance, Recorded, Simulated, scenario_in
from twinct.scan.rig import LocalRig, Rig, RigFactory, local_rig
from twinct.scan.saving import save_scan
from twinct.scan.store import Readings, ScanStore, check_space
from twinct.scan.sweeps import Sweeps

__all__ = [
    "RigFactory",
    "OWN",
    "RELATIVE",
    "Imported",
    "LocalRig",
    "NamedGeometry",
    "Provenance",
    "Readings",
    "Recorded",
    "Rig",
    "Scan",
    "Simulated",
    "ScanStore",
    "Stopwatch",
    "Sweeps",
    "View",
    "SimulationBuilder",
    "acquire",
    "check_space",
    "checked_name",
    "frame_damage",
    "image_digests",
    "free_geometry_name",
    "line_integrals",
    "local_rig",
    "never",
    "named_geometries",
    "save_scan",
    "scenario_in",
    "store_geometries",
    "unknown_files",
    "view_damage",
    "write_frame",
]
