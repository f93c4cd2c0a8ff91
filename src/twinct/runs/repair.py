"""Repair of the files of a scan store that belong to no single view (its frame)."""

from __future__ import annotations

import logging
from pathlib import Path

from twinct.core.errors import DamagedError
from twinct.core.files.lock import sole_owner
from twinct.core.files.private import private_folder
from twinct.runs.folder import Folder
from twinct.scan import ScanStore, SimulationBuilder, write_frame
from twinct.scan.damage import clear_paths, root_digest
from twinct.scan.manifest import FRAME_FILE, ROOT, compared, read_frame_manifest
from twinct.scenario import Scenario

log = logging.getLogger(__name__)


def resumable(folder: Folder, scenario: Scenario) -> ScanStore:
    """Open the store of a run to be resumed, and repair its frame if it is damaged.

    Damaged views are not repaired but acquired again, see ``ScanStore.resume``.

    Raises:
        DamagedError: the scenario does not yield the same frame; nothing has been changed.
        InputError: the scenario cannot be planned.
    """
    try:
        return ScanStore(folder.scan)
    except DamagedError as error:
        with sole_owner(folder.lock):
            mend_frame(folder.scan, SimulationBuilder(scenario), error)
    return ScanStore(folder.scan)


def mend_frame(path: Path, builder: SimulationBuilder, error: DamagedError) -> None:
    """Recreate the files that an error lists, from the scenario.

    Raises:
        DamagedError: the new files differ from the original ones; nothing has been changed.
    """
    clear_paths(path, error.damages)
    scenario = builder.scenario
    reached = builder.robots().move(0, builder.targets[0])
    robots = reached.joint_names, len(reached.state), builder.followed
    with private_folder(path.parent) as folder:
        draft = folder / path.name
        write_frame(draft, scenario, builder.commanded_poses, *robots, mas=builder.mas)
        fresh = read_frame_manifest(draft) or {}
        broken = [damage.file for damage in error.damages]
        if FRAME_FILE in broken:  # then only the root's digest identifies the scan
            digests, vouched = {ROOT: root_digest(path)}, [ROOT]
            broken = [FRAME_FILE, *(damage.file for damage in compared(path, fresh))]
        else:
            digests, vouched = read_frame_manifest(path) or {}, broken
        if others := [file for file in vouched if fresh.get(file) != digests[file]]:
            raise DamagedError(
                [
                    *error.problems,
                    f"{path}: {', '.join(others)} cannot be recreated: this scenario, or its plan "
                    "by this version, gives other contents; use the scenario that the scan was "
                    "started with",
                ],
                error.damages,
            )
        for file in broken:
            (path / file).parent.mkdir(parents=True, exist_ok=True)
            (draft / file).replace(path / file)
            log.warning("%s: %s recreated unchanged", path, file)
