"""Damage of a store: named, never read as data, and mended to the very bytes."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from twinct import run
from twinct.cli import run_command
from twinct.core.errors import DamagedError, ScanExistsError
from twinct.geometry import Floats
from twinct.recon.volume import Volume
from twinct.runs import Run, acquire_to_store, verify
from twinct.runs.repair import mend_frame
from twinct.scan import (
    Rig,
    ScanStore,
    SimulationBuilder,
    frame_damage,
    image_digests,
    local_rig,
    view_damage,
)
from twinct.scan.checked import CheckedStore
from twinct.scan.manifest import FRAME_FILE, view_of
from twinct.scenario import Scenario

CHANGES, DELETIONS = 50, 10
VERSION_0_1 = Path(__file__).parents[1] / "version_0_1"


def contents(path: Path) -> dict[str, bytes]:
    """Of all files of a store, and none that is empty."""
    files = {str(f.relative_to(path)): f for f in sorted(path.rglob("*")) if f.is_file()}
    return {name: file.read_bytes() for name, file in files.items()}


def damages(store: dict[str, bytes], seed: int) -> list[tuple[str, bytes | None]]:
    """Files and what becomes of them: a byte anywhere changed, or a chunk gone."""
    rng = np.random.default_rng(seed)
    names, sizes = list(store), np.array([len(data) for data in store.values()])
    found: list[tuple[str, bytes | None]] = []
    for place in rng.choice(sizes.sum(), CHANGES, replace=False):
        index = int(np.searchsorted(np.cumsum(sizes), place, side="right"))
        data = bytearray(store[names[index]])
        data[int(place - sizes[:index].sum())] ^= int(rng.integers(1, 256))
        found.append((names[index], bytes(data)))
    chunks = [name for name in names if not name.endswith("zarr.json")]
    return found + [(str(name), None) for name in rng.choice(chunks, DELETIONS, replace=False)]


def put(file: Path, data: bytes | None) -> None:
    if data is None:
        file.unlink(missing_ok=True)
    else:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)


def read_everything(path: Path) -> None:
    """Whatever a scan is asked for, and all arrays besides."""
    ScanStore(path).read()
    group: Any = zarr.open_group(CheckedStore(path), mode="r")
    for _, member in group.members(max_depth=None):
        if isinstance(member, zarr.Array):
            member[...]


@pytest.fixture
def folder(finished: Run, tmp_path: Path) -> Path:
    return shutil.copytree(finished.paths.path, tmp_path / "out")


def test_every_damage_is_named_and_none_is_read(folder: Path, figure) -> None:
    path = folder / "scan.zarr"
    read_everything(path)
    assert verify(folder).problems == verify(folder).unknown == ()
    store, named = contents(path), 0
    for file, data in damages(store, seed=1):
        put(path / file, data)
        found = [*frame_damage(path), *view_damage(path)]
        if found:
            assert [d.file for d in found] == [file]
            assert found[0].what == ("missing" if data is None else "changed")
            assert found[0].view == view_of(file)
            with pytest.raises(DamagedError, match=f"{path}: .*{found[0]}"):
                read_everything(path)
        else:  # as if it had never been taken
            assert file == "status/c.9" and data is None
            with pytest.raises(ScanExistsError, match="9 of 10 views"):
                read_everything(path)
        named += len(verify(folder).problems)
        put(path / file, store[file])
    assert verify(folder).problems == ()
    figure(f"{named} of {CHANGES + DELETIONS} named, none read")
    assert named == CHANGES + DELETIONS


@pytest.mark.usefixtures("unreported")
def test_a_run_goes_on_with_a_damaged_store_and_mends_it(
    folder: Path, finished: Run, figure
) -> None:
    path, before = folder / "scan.zarr", (folder / "volume.nii").stat().st_mtime_ns
    store = contents(path)
    hit = damages(store, seed=2)
    for file, data in hit:
        put(path / file, data)
    whole = set(range(10)) - {view_of(file) for file, _ in hit}
    run(finished.scenario, folder, link="local", resume=True)
    assert contents(path) == store
    assert verify(folder).problems == ()
    assert (folder / "volume.nii").stat().st_mtime_ns == before  # of these very views
    figure(f"{len(hit)} damages at once, {10 - len(whole)} of 10 views: equal bytes")


@pytest.mark.usefixtures("unreported")
def test_a_finished_run_whose_last_view_is_lost_is_not_complete(
    folder: Path, finished: Run
) -> None:
    path = folder / "scan.zarr"
    store = contents(path)
    (path / "status" / "c.9").unlink()  # no damage: as if it had never been taken
    run(finished.scenario, folder, link="local", resume=True)
    assert contents(path) == store


class Counted:
    """A factory of rigs that notes what is taken."""

    def __init__(self) -> None:
        self.taken: list[int] = []

    def __call__(self, builder: SimulationBuilder, first: int, state: Floats | None) -> Rig:
        rig = local_rig(builder, first, state)
        expose = rig.expose
        rig.expose = lambda view: self.taken.append(view) or expose(view)
        return rig


@pytest.mark.tutorial
@pytest.mark.parametrize("scheme", ["planned", "reactive"])
def test_views_in_the_middle_are_taken_again_from_the_state_before(
    tiny: Callable[..., Scenario], tmp_path: Path, scheme: str
) -> None:
    builder, path = (
        SimulationBuilder(tiny(f"motion.scheme={scheme}", "detector.lag=0.1")),
        tmp_path / "s",
    )
    acquire_to_store(builder, path, local_rig, resume=False)
    store = contents(path)
    (path / "transmission" / "c.3.0.0").unlink()
    (path / "state" / "c.6.0").write_bytes(b"short")
    (path / "executed" / "u" / "c.7.0").write_bytes(bytes(24))
    assert {d.view for d in view_damage(path)} == {3, 6, 7}
    (path / "somebody.txt").write_text("else's")
    ScanStore.resume(path, image_digests(builder.scenario))  # and is killed then
    rigs = Counted()
    acquire_to_store(builder, path, rigs, resume=True)
    assert rigs.taken == [3, 6, 7]
    assert contents(path) == store | {"somebody.txt": b"else's"}
    assert [file.name for file in verify(path).unknown] == ["somebody.txt"]


@pytest.fixture(scope="module")
def builder(finished: Run) -> SimulationBuilder:
    return SimulationBuilder(finished.scenario)


@pytest.fixture(scope="module")
def shorter(tiny: Callable[..., Scenario]) -> SimulationBuilder:
    return SimulationBuilder(tiny("trajectory.views=2"))


@pytest.mark.tutorial
@pytest.mark.parametrize("lost", ["zarr.json", FRAME_FILE, "plan/views/zarr.json", "manifest"])
def test_what_is_of_no_view_is_made_anew(
    folder: Path, builder: SimulationBuilder, shorter: SimulationBuilder, lost: str
) -> None:
    path = folder / "scan.zarr"
    store = contents(path)
    if (path / lost).is_dir():
        shutil.rmtree(path / lost)
    else:
        (path / lost).write_bytes(b"{}")
    left = contents(path)
    with pytest.raises(DamagedError) as error:
        ScanStore(path)
    with pytest.raises(DamagedError, match=r"json cannot be recreated: this scenario, or"):
        mend_frame(path, shorter, error.value)
    assert contents(path) == left
    mend_frame(path, builder, error.value)
    rows = {file for file in store if file.startswith("manifest/views/c.")}
    views = rows if lost == "manifest" else set()  # their views are taken again
    assert contents(path) == {file: store[file] for file in store.keys() - views}
    assert {damage.file for damage in view_damage(path)} == views


def test_results_beside_the_store_are_looked_at(folder: Path, capsys) -> None:
    assert run_command(["verify", str(folder)]) == 0
    assert "intact (10 of 10 views)" in "".join(capsys.readouterr())
    file = folder / "geometries" / "believed.json"
    file.write_text(file.read_text().replace("1", "2", 1))
    (folder / "volume.nii").write_bytes(b"no volume")
    (folder / "metrics.json").write_text("{")
    (folder / "scan.zarr" / "mine.txt").write_text("mine")
    assert run_command(["verify", str(folder)]) == 1
    said = "".join(capsys.readouterr())
    for words in ("believed.json", "volume.nii", "metrics.json", "mine.txt: unknown", "3 problems"):
        assert words in said
    assert run_command(["verify", str(folder / "geometries")]) == 2


@pytest.mark.usefixtures("unreported")
def test_a_replaced_volume_is_noticed_and_made_again(folder: Path, finished: Run, capsys) -> None:
    file, whole = folder / "volume.nii", (folder / "volume.nii").read_bytes()
    file.write_bytes(whole[:-4] + b"abcd")  # of the run by its header
    assert run_command(["verify", str(folder)]) == 1
    assert f"{file} was changed or replaced" in "".join(capsys.readouterr())
    assert run_command(["report", str(folder)]) == 2
    assert "--resume' makes it again" in capsys.readouterr().err
    run(finished.scenario, folder, link="local", resume=True)
    assert file.read_bytes() == whole and verify(folder).problems == ()
    file.unlink()
    assert "volume.nii missing" in verify(folder).problems[0]


def test_a_volume_of_another_run_is_noticed_without_digests(folder: Path) -> None:
    """As the figures of earlier versions have none."""
    metrics = folder / "metrics.json"
    metrics.write_text(json.dumps(json.loads(metrics.read_text()) | {"files": None}))
    assert verify(folder).problems == ()
    Volume.read(folder / "volume.nii").write(folder / "volume.nii", "another")
    assert "made with settings other than" in verify(folder).problems[0]


def test_a_store_without_manifest_is_looked_at_as_far_as_can_be(tmp_path: Path) -> None:
    shutil.unpack_archive(VERSION_0_1 / "local.tar.xz", tmp_path)
    path = tmp_path / "scan.zarr"
    assert "older format without digests" in verify(tmp_path).in_words
    assert verify(tmp_path).problems == verify(tmp_path).unknown == ()
    (path / "joints" / "c.2.0").unlink()
    (path / "executed" / "u" / "c.1.0").write_bytes(b"short")
    image = path / "transmission" / "c.0.0.0"
    good = image.read_bytes()
    image.write_bytes(b"no image")
    told = verify(tmp_path).problems
    assert len(told) == 3
    for problem, words in zip(
        told, ("view 1, executed/u", "view 2, joints", "view 0"), strict=True
    ):
        assert words in problem
    image.write_bytes(good)
    with pytest.raises(DamagedError, match="view 2, joints: missing"):
        ScanStore(path).read()


@pytest.mark.process
def test_other_tools_can_check_a_store(finished: Run) -> None:
    path = finished.paths.scan
    lists = [FRAME_FILE, *(f"manifest/views/c.{view}.0" for view in range(10))]
    check = ["sha256sum", "--check", "--strict", "--quiet", *lists]
    subprocess.run(check, cwd=path, check=True)


WITHOUT_ROBOTS = """
import sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("mujoco", "mink", "daqp", "ruckig", "ompl"):
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Absent())
from twinct.runs import verify
print(verify(sys.argv[1]).problems)
"""


@pytest.mark.process
def test_a_scan_of_arms_is_verified_without_the_robots_extra(tmp_path: Path) -> None:
    kept = Path(__file__).parents[1] / "version_1_0" / "local.tar.xz"
    shutil.unpack_archive(kept, tmp_path)
    folder = tmp_path / "local"
    assert (folder / "scan.zarr" / "plan").is_dir()
    command = [sys.executable, "-c", WITHOUT_ROBOTS, str(folder)]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "()\n"
