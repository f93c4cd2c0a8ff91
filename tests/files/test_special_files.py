"""Pipes and devices in place of a file: each reader says so at once, and opens none of them."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from twinct import load_scan
from twinct.core.errors import InputError
from twinct.core.files.arm_xml import read_arm_xml
from twinct.core.files.arrays import read_npy, read_npz
from twinct.core.files.images import RawImage, read_image
from twinct.core.files.plain_json import read_json
from twinct.core.files.plain_yaml import read_file
from twinct.core.files.tables import read_columns, read_curve
from twinct.core.files.writing import check_folder
from twinct.ctsimu.scenario import load_ctsimu
from twinct.geometry import Panel
from twinct.runs import compare, verify
from twinct.runs.export import export_scan
from twinct.runs.folder import Folder, read_metrics
from twinct.runs.reconstruction_folder import FORMAT, StoredReconstruction
from twinct.scan.manifest import compared
from twinct.scan.named_geometries import NamedGeometry
from twinct.scenario import load_scenario
from twinct.study import load_study
from twinct.trajectory import commanded_views
from twinct.trajectory.table import FileTrajectory

SPECIAL = {"pipe": "is a named pipe (FIFO), not a file", "device": "is a device, not a file"}


@pytest.fixture(params=SPECIAL)
def special(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str]:
    """Return a path and the words that say what is there."""
    path = tmp_path / "special"
    os.mkfifo(path) if request.param == "pipe" else path.symlink_to("/dev/zero")
    return path, SPECIAL[request.param]


def views(path: Path) -> object:
    return commanded_views(FileTrajectory(kind="file", path=path), Panel(4, 3, 1.0, 1.0))


READERS: dict[str, Callable[[Path], object]] = {
    "scenario": load_scenario,
    "extended scenario": lambda path: load_scenario({"extends": str(path)}),
    "study": load_study,
    "YAML": lambda path: read_file(path, "scenario"),
    "JSON": read_json,
    "CTSimU": load_ctsimu,
    "columns": lambda path: read_columns(path, 2),
    "curve": read_curve,
    "views": views,
    "picture": lambda path: read_image(path, "bad pixels", (3, 4)),
    "raw image": lambda path: read_image(RawImage(path, "u1", 4, 3, 0), "bad pixels"),
    "npy": lambda path: read_npy(path, "it"),
    "npz": lambda path: read_npz(path, "it", 100),
    "arm": lambda path: read_arm_xml(path, "it"),
    "geometry": NamedGeometry.read,
    "metrics": read_metrics,
    "run": Folder,
    "scan": load_scan,
    "verified": verify,
    "exported": lambda path: export_scan(path, "rtk"),
    "compared": lambda path: compare([path, path]),
}


@pytest.mark.parametrize("reader", READERS)
def test_a_reader_says_what_is_there(special: tuple[Path, str], reader: str) -> None:
    path, what = special
    with pytest.raises((InputError, ValueError), match=re.escape(what)):
        READERS[reader](path)


def test_a_recording_is_a_file(special: tuple[Path, str]) -> None:
    pytest.importorskip("mcap")
    from twinct.link.recording.reader import Recording

    with pytest.raises(InputError, match=re.escape(special[1])):
        Recording(special[0])


def test_a_store_names_it_as_damage(special: tuple[Path, str]) -> None:
    (damage,) = compared(special[0].parent, {"special": "0" * 64})
    assert str(damage) == f"special: {special[1]}"


def test_a_folder_of_results_holds_none(special: tuple[Path, str]) -> None:
    with pytest.raises(InputError, match=re.escape(f"special {special[1]}")):
        check_folder(special[0].parent, {"special"})


@pytest.mark.parametrize("name", ["sections.npz", "reconstruction.json"])
def test_parts_of_a_reconstruction_are_files(special: tuple[Path, str], name: str) -> None:
    folder, what = special[0].parent, special[1]
    (folder / "reconstruction.json").write_text(
        f'{{"format": "{FORMAT}", "slices": {{"xy": [[0, 1, 0, 1], ["x", "y"], 0.0]}}}}'
    )
    (folder / name).unlink(missing_ok=True)
    special[0].rename(folder / name)
    with pytest.raises(InputError, match=re.escape(f"{name} {what}")):
        StoredReconstruction.read(folder)


@pytest.mark.parametrize("reader", ["run", "scan", "verified", "exported", "compared"])
def test_a_name_that_no_file_can_have_is_refused(reader: str) -> None:
    with pytest.raises(InputError, match="File name too long"):
        READERS[reader](Path("x" * 70_000))
