"""A stranger's folder of results: links planted in it lead no command to another file."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from twinct import judge_run, reconstruct_run, run
from twinct.calibration import calibrate_run
from twinct.core.errors import InputError
from twinct.core.files.folder_paths import names_below
from twinct.measured import predict
from twinct.runs import Run
from twinct.runs.folder import Folder
from twinct.scan import ScanStore
from twinct.scenario import Scenario

FOLDERS = {"scan.zarr", "geometries", "reconstructions", "predictions", "checkpoints"} | {
    "inputs",
    "log",
}
NAMES = names_below(Folder)


def drafts_of(name: str) -> list[str]:
    """Names that drafts had when everybody knew them."""
    suffix = Path(name).suffix
    return [f".{name}.partial{suffix}", f".{name}.partial", f"{name}.partial", f"{name}.new"]


@pytest.fixture
def outside(tmp_path: Path) -> Iterator[Path]:
    """A folder with a file, both of which stay as they are."""
    (folder := tmp_path / "outside").mkdir()
    (folder / "file").write_text("mine")
    yield folder
    assert [path.name for path in folder.iterdir()] == ["file"]
    assert (folder / "file").read_text() == "mine"


@pytest.fixture
def copied(finished: Run, tmp_path: Path) -> Path:
    """A finished run, to be changed."""
    return Path(shutil.copytree(finished.paths.path, tmp_path / "out"))


def targets(outside: Path, name: str) -> tuple[Path, Path]:
    """A place that is there, and one that is not."""
    return (outside if name in FOLDERS else outside / "file"), outside / "new"


def refused(link: Path, work: Callable[[], object]) -> None:
    with pytest.raises(InputError, match=rf"{re.escape(str(link))} is a symbolic link"):
        work()
    link.unlink()


@pytest.mark.parametrize("name", NAMES)
def test_a_run_in_a_folder_with_a_planted_link(
    tiny: Callable[..., Scenario], tmp_path: Path, outside: Path, name: str
) -> None:
    """At the place of each file, folder, log and lock of a run, and of each of their drafts."""
    scenario, out = tiny("cell={kind: gantry}"), tmp_path / "out"
    out.mkdir()
    for planted in (name, *drafts_of(name)):
        for target in targets(outside, name):
            (link := out / planted).symlink_to(target)
            with pytest.raises(InputError):
                run(scenario, out, link="local", resume=True)
            link.unlink()
            assert not list(out.iterdir())


@pytest.mark.parametrize(
    "command",
    [
        lambda out: reconstruct_run(out),
        lambda out: judge_run(out),
        lambda out: calibrate_run(out, "self"),
        lambda out: predict(out),
    ],
    ids=["reconstruct", "judge", "calibrate", "predict"],
)
def test_a_command_on_a_run_with_a_planted_link(
    copied: Path, outside: Path, command: Callable[[Path], object]
) -> None:
    before = {path: path.lstat().st_mtime_ns for path in copied.rglob("*")}
    there = [name for name in NAMES if (copied / name).exists()]
    for name in (n for name in NAMES for n in (name, *drafts_of(name)) if n not in there):
        for target in targets(outside, name):
            (link := copied / name).symlink_to(target)
            refused(link, lambda: command(copied))
    assert {path: path.lstat().st_mtime_ns for path in copied.rglob("*")}.keys() == before.keys()


def test_a_run_below_a_link_of_the_user_goes_on(copied: Path, tmp_path: Path) -> None:
    (tmp_path / "short").symlink_to(copied)
    made = reconstruct_run(tmp_path / "short", name="again")
    assert (copied / "reconstructions" / "again" / "volume.nii").is_file() and made.figures


def unfinished(out: Path) -> None:
    """Take a run's last view away."""
    (out / "scan.zarr" / "status" / "c.9").unlink()
    (out / "volume.nii").unlink()


def test_files_of_a_view_that_are_links_are_replaced(
    copied: Path, finished: Run, outside: Path
) -> None:
    unfinished(copied)
    store = copied / "scan.zarr"
    files = [path for path in store.rglob("c.9*") if "commanded" not in path.parts]
    assert len(files) > 15
    for file in files:
        file.unlink()
        file.symlink_to(outside / "file")
    for draft in (store / "status" / "c.9", store / "status" / "c.9.partial"):
        draft.symlink_to(outside / "new")
    with ScanStoreWritten(copied, finished.scenario) as resumed:
        assert resumed.acquired == 9
    assert not any(path.is_symlink() for path in store.rglob("*"))


class ScanStoreWritten:
    """A store continued by its last view."""

    def __init__(self, out: Path, scenario: Scenario) -> None:
        self.store = ScanStore.resume(out / "scan.zarr", scenario)

    def __enter__(self) -> ScanStore:
        return self.store

    def __exit__(self, *_: object) -> None:
        pass
