"""Writing of a scan in memory as a store."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.writing import complete, storage_errors
from twinct.geometry.wire import PosePairs
from twinct.scan.data import Acquired, Scan
from twinct.scan.layout import write_frame
from twinct.scan.named_geometries import poses_digest
from twinct.scan.store import ScanStore, check_space
from twinct.scenario import with_files_in

CHANGED = {"images": "changed"}
"""Digests of images that are no longer those of the acquisition: no scenario's, so that no run
continues with them as if it had taken them."""


def save_scan(scan: Scan, path: Path) -> None:
    """Write a scan as a store; see ``Scan.save``.

    Raises:
        InputError: the scan lacks what a store holds.
        ScanExistsError: the path exists.
        StorageError: the store cannot be written; what was written is removed.
    """
    if path.exists():
        raise ScanExistsError(f"{path} exists already: choose another path")
    acquired, taken = _acquired(scan), scan.simulated
    check_space(path.parent, scan.scenario, len(scan))
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with complete(path) as draft:
            write_frame(
                draft,
                with_files_in(scan.scenario, path.parent / "inputs"),
                scan.commanded,
                taken.joint_names,
                len(acquired.reached[0].state),
                acquired.plan,
                None if scan.transmission is acquired.transmission else CHANGED,
                scan.mas,
            )
            store = ScanStore(draft)
            for index, reached in enumerate(acquired.reached):
                store.write(index, scan.transmission[index], reached)


def _acquired(scan: Scan) -> Acquired:
    """Return what was acquired, after checking that it makes a whole store."""
    acquired = scan.simulated.acquired
    if acquired is None:
        raise InputError(
            "this scan is not from simulate(), so that its joint speeds, torques and states of the "
            "simulation are unknown; if it was loaded, copy its scan.zarr"
        )
    if keep := scan.scenario.detector.keep:
        raise InputError(
            f"detector.keep ({', '.join(keep)}): a scan in memory has no such images; "
            "run the scenario into a folder, or simulate it without detector.keep"
        )
    executed = PosePairs.joined(view.executed for view in acquired.reached)
    joints = [view.position for view in acquired.reached]
    same = poses_digest(executed) == poses_digest(scan.executed)
    if not same or not np.array_equal(scan.joints, joints):
        raise InputError("executed poses or joints are not those of the acquisition any more")
    return acquired
