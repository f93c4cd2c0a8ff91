"""A stranger's folder of results: links planted in it lead no command to another file."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from twinct import run
from twinct.calibration.calibrate import calibrate
from twinct.core.errors import InputError
from twinct.core.files.folder_paths import names_below
from twinct.measured.prediction import predict
from twinct.runs import Run, reconstruct_run, rewrite_report
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
    names = f".{name}.partial{suffix}", f".{name}.partial", f"{name}.partial", f"{name}.new"
    return list(dict.fromkeys(names))


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
        reconstruct_run,
        rewrite_report,
        lambda folder: calibrate(folder, "self"),
        predict,
    ],
    ids=["reconstruct", "report", "calibrate", "predict"],
)
def test_a_command_on_a_run_with_planted_links(
    copied: Path, outside: Path, tmp_path: Path, command: Callable[[Path], object]
) -> None:
    """At its lock; at all that is not there yet, drafts included; and at its results."""
    names = [n for name in NAMES for n in (name, *drafts_of(name)) if not (copied / n).exists()]
    assert len(names) > 3 * len(NAMES)
    (copied / "twinct.lock").symlink_to(outside / "file")
    refused(copied / "twinct.lock", lambda: command(copied))
    names.remove("twinct.lock")
    for target in (0, 1):
        links = [copied / name for name in names]
        for link in links:
            link.symlink_to(targets(outside, link.name)[target])
        with pytest.raises(InputError, match="is a symbolic link"):
            command(copied)
        for link in links:
            link.unlink()
    for name in ("metrics.json", "report.html", "volume.nii", "geometries"):
        (copied / name).rename(moved := tmp_path / name)
        before = moved.stat().st_mtime_ns
        (copied / name).symlink_to(moved)
        refused(copied / name, lambda: command(copied))
        assert moved.stat().st_mtime_ns == before
        moved.rename(copied / name)


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
    store, transmission = copied / "scan.zarr", finished.scan.transmission
    files = [path for path in store.rglob("c.9*") if "commanded" not in path.parts]
    assert len(files) > 15
    for file in files:
        file.unlink()
        file.symlink_to(outside / "file")
    (store / "status" / "c.9").unlink()
    for name in ("c.9", "c.9.partial", ".c.9.partial", ".c.9.partial.9"):
        (store / "status" / name).symlink_to(outside / "new")
    run(finished.scenario, copied, link="local", resume=True)
    assert not any((store / "status" / name).is_symlink() for name in ("c.9", "c.9.partial"))
    assert not any(file.is_symlink() for file in files)
    assert (ScanStore(store).transmission(9) == transmission[9]).all()


def test_a_linked_folder_in_a_store_is_refused(
    copied: Path, finished: Run, outside: Path, tmp_path: Path
) -> None:
    """Also where its content is that of the store, so that nothing seems to be damaged."""
    store = copied / "scan.zarr"
    (store / "status" / "c.9").unlink()
    for name in ("transmission", "status", "manifest/views", "executed", "joints"):
        moved = tmp_path / "moved"
        (store / name).rename(moved)
        before = {path: path.stat().st_mtime_ns for path in moved.rglob("*")}
        (store / name).symlink_to(moved)
        with pytest.raises(InputError, match=f"{name}: a symbolic link stands in the way"):
            run(finished.scenario, copied, link="local", resume=True)
        assert {path: path.stat().st_mtime_ns for path in moved.rglob("*")} == before
        (store / name).unlink()
        moved.rename(store / name)
