"""The scan store: bit-exact, resumable, never overwritten, as other tools expect it."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from twinct.core.errors import InputError, ScanExistsError, StorageError
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, Reached
from twinct.scan import ScanStore, check_space, frame_damage, image_digests, view_damage
from twinct.scan.checked import CheckedStore
from twinct.scan.manifest import write_frame_manifest
from twinct.scenario import Scenario, load_scenario
from twinct.trajectory import commanded_views
from twinct.uncertainty import believed_poses

VIEWS = 5
NAMES = ("source_a", "detector_b")


@pytest.fixture
def scenario() -> Scenario:
    demo = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
    return load_scenario(
        demo, [f"trajectory.views={VIEWS}", "detector.columns=7", "detector.rows=5"]
    )


@pytest.fixture
def commanded(scenario: Scenario) -> PosePairs:
    return PosePairs.from_geometry(commanded_views(scenario.trajectory, scenario.detector.panel))


def view(index: int, *, instants: bool = False) -> tuple[np.ndarray, Reached]:
    rng = np.random.default_rng(index)

    def pose(z_mm: float = 0.0) -> Pose:
        return Pose.from_euler(rng.normal(size=3) + (0, 0, z_mm), rng.uniform(-40, 40, 3))

    def instant() -> PosePairs:  # the source before the panel
        source, specimen, panel = pose(500.0), pose(), pose()
        return PosePairs.at(source, panel, specimen)

    reached = Reached(
        executed=instant(),
        joint_names=NAMES,
        position=rng.random(2),
        velocity=rng.random(2),
        effort=rng.random(2),
        state=rng.random(9),
        time_s=index,
        clearance_mm=1.5,
        exposure=PosePairs.joined([instant(), instant()] if instants else []),
    )
    return rng.random((5, 7), dtype=np.float32), reached


def harder(scenario: Scenario) -> Scenario:
    """The same with other images."""
    source = scenario.source.model_copy(update={"energy_kev": 90.0})
    return scenario.model_copy(update={"source": source})


def fill(path: Path, scenario: Scenario, commanded: PosePairs, views: range) -> ScanStore:
    store = (
        ScanStore.resume(path, image_digests(scenario))
        if path.exists()
        else ScanStore.create(path, scenario, commanded, NAMES, 9)
    )
    for index in views:
        store.write(index, *view(index))
    return store


def contents(path: Path) -> dict[str, str]:
    return {
        str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(path.rglob("*"))
        if file.is_file()
    }


def test_a_scan_reads_back_to_the_last_bit(tmp_path, scenario, commanded) -> None:
    scan = fill(tmp_path / "s.zarr", scenario, commanded, range(VIEWS)).read()
    for index in range(VIEWS):
        image, reached = view(index)
        np.testing.assert_array_equal(scan.transmission[index], image)
        executed = reached.executed
        assert scan.executed[index] == executed[0]
        uncertainty, seed = scenario.uncertainty, scenario.believed_seed
        drawn = believed_poses(*executed[0], uncertainty, seed, index)
        assert scan.believed[index] == drawn
        assert scan.simulated.executed_object[index] == executed.object[0]
        assert scan.commanded[index] == commanded[index]
        np.testing.assert_array_equal(scan.joints[index], reached.position)
    assert scan.scenario == scenario
    assert scan.simulated.joint_names == NAMES
    assert scan.poses("believed") is scan.believed
    with pytest.raises(InputError, match="'scenario'; choose from commanded, executed, believed"):
        scan.poses("scenario")


def test_mas_of_each_view_reads_back_to_the_last_bit(tmp_path, scenario, commanded) -> None:
    mas = np.array([0.01, 0.02, 1 / 3, 0.04, 5.0])
    path = tmp_path / "s.zarr"
    ScanStore.create(path, scenario, commanded, NAMES, 9, mas=mas)
    store = fill(path, scenario, commanded, range(VIEWS))
    scan = store.read()
    np.testing.assert_array_equal(scan.mas, mas)
    np.testing.assert_array_equal(scan.exposures_rel, mas / scenario.source.mas)
    assert not store.damage
    assert fill(tmp_path / "t.zarr", scenario, commanded, range(VIEWS)).read().mas is None


def test_instants_of_an_exposure_read_back_to_the_last_bit(tmp_path, scenario, commanded) -> None:
    blurred = scenario.model_copy(
        update={"source": scenario.source.model_copy(update={"motion_samples": 2})}
    )
    store = ScanStore.create(tmp_path / "s.zarr", blurred, commanded, NAMES, 9)
    for index in range(VIEWS):
        store.write(index, *view(index, instants=True))
    written = [view(index, instants=True)[1].exposure for index in range(VIEWS)]
    assert store.read().simulated.exposure == tuple(written)
    unblurred = fill(tmp_path / "u.zarr", scenario, commanded, range(VIEWS)).read()
    assert unblurred.simulated.exposure == ()


def test_foreign_readers_find_the_contract(tmp_path, scenario, commanded) -> None:
    fill(tmp_path / "s.zarr", scenario, commanded, range(VIEWS))
    group = zarr.open_group(str(tmp_path / "s.zarr"), mode="r")
    assert group["transmission"].shape == (VIEWS, 5, 7)
    assert group["transmission"].chunks == (1, 5, 7)
    assert group["transmission"].dtype == np.float32
    for which in ("commanded", "executed"):
        for name, width in (("source", 3), ("u", 3), ("v", 3), ("detector_quat", 4)):
            assert group[f"{which}/{name}"].shape == (VIEWS, width)
        axes = np.cross(group[f"{which}/u"][:], group[f"{which}/v"][:])
        np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1)
    for name, index in (("source", 2), ("object", 1)):
        (written,) = getattr(view(index)[1].executed, name)
        np.testing.assert_array_equal(group[f"executed/{name}"][index], written.position)
    assert group.attrs["pixel_pitch_mm"] == [2.0, 2.0]


@pytest.mark.parametrize("killed_at", ["image", "poses", "status", "draft"])
def test_resume_after_a_killed_write_gives_the_same_bytes(
    tmp_path, scenario, commanded, killed_at: str
) -> None:
    whole, broken = tmp_path / "whole.zarr", tmp_path / "broken.zarr"
    fill(whole, scenario, commanded, range(VIEWS))
    store = fill(broken, scenario, commanded, range(2))
    store.write(2, *view(4))  # another view's numbers: none of them may survive
    (broken / "status" / "c.2").unlink()
    if killed_at == "image":
        for file in broken.rglob("c.2*"):
            if not {"transmission", "commanded"} & set(file.parts):
                file.unlink()
    if killed_at == "draft":
        (broken / "joints" / "c.3.0").write_bytes(b"half")
        (broken / "transmission" / "c.3.0.0.5d41.partial").write_bytes(b"half")
    assert ScanStore.resume(broken, image_digests(scenario)).acquired == 2
    fill(broken, scenario, commanded, range(2, VIEWS))
    assert contents(broken) == contents(whole)


def test_an_existing_scan_is_never_touched(tmp_path, scenario, commanded) -> None:
    path = tmp_path / "s.zarr"
    fill(path, scenario, commanded, range(2))
    before = contents(path)
    with pytest.raises(ScanExistsError, match="already holds a scan"):
        ScanStore.create(path, scenario, commanded, NAMES, 9)
    other = harder(scenario)
    with pytest.raises(ScanExistsError, match="another scenario"):
        ScanStore.resume(path, image_digests(other))
    assert contents(path) == before
    with pytest.raises(ScanExistsError, match="2 of 5 views"):
        ScanStore(path).read()


def test_a_store_that_cannot_be_made_leaves_no_draft(
    tmp_path, scenario, commanded, monkeypatch
) -> None:
    def fill_up(draft: Path, *_: object) -> None:
        draft.mkdir()
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr("twinct.scan.store.write_frame", fill_up)
    with pytest.raises(StorageError, match="disk is full"):
        ScanStore.create(tmp_path / "s.zarr", scenario, commanded, NAMES, 9)
    assert not list(tmp_path.iterdir())


def spoilt(index: int, name: str, values: np.ndarray) -> tuple[np.ndarray, Reached]:
    image, reached = view(index)
    if name == "transmission":
        return values, reached
    return image, replace(reached, **{{"joints": "position"}.get(name, name): values})


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("transmission", np.ones((1, 1), np.float32)),
        ("transmission", np.ones((1, 7), np.float32)),
        ("state", np.zeros(8)),
        ("joints", np.zeros(0)),
    ],
)
def test_a_view_of_another_shape_is_refused_and_leaves_nothing(
    tmp_path, scenario, commanded, name, values
) -> None:
    """A single pixel would be spread over the whole image, a short state written as it is."""
    store = fill(tmp_path / "scan.zarr", scenario, commanded, range(1))
    before = contents(tmp_path)
    with pytest.raises(InputError, match=f"{name} of view 1 has .* metadata are damaged"):
        store.write(1, *spoilt(1, name, values))
    assert contents(tmp_path) == before and store.acquired == 1


def test_a_full_disk_loses_nothing(tmp_path, scenario, commanded, monkeypatch) -> None:
    store = fill(tmp_path / "s.zarr", scenario, commanded, range(2))

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(StorageError, match="disk is full"):
            store.write(2, *view(2))
    assert ScanStore.resume(tmp_path / "s.zarr", image_digests(scenario)).acquired == 2


def test_too_little_space_is_said_before_the_start(tmp_path, scenario, monkeypatch) -> None:
    check_space(tmp_path / "not" / "there" / "yet", scenario, VIEWS)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: type("U", (), {"free": 10})())
    with pytest.raises(StorageError, match=r"need up to 0\.\d+ GiB, but only 0\.00 GiB"):
        check_space(tmp_path, scenario, VIEWS)


def rewritten(path: Path, **attributes: object) -> None:
    """Change what the store says of itself, and take its manifest, which would tell."""
    shutil.rmtree(path / "manifest")
    file = path / "zarr.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    content["attributes"] |= attributes
    file.write_text(json.dumps(content), encoding="utf-8")


def test_a_store_of_an_unknown_format_is_refused_by_name(tmp_path, scenario, commanded) -> None:
    path = tmp_path / "s.zarr"
    fill(path, scenario, commanded, range(VIEWS))
    rewritten(path, format=9)
    with pytest.raises(
        InputError, match=r"s\.zarr: the scan store has format 9; .* reads 1 and 2 and 3 and 4"
    ):
        ScanStore(path)


def test_a_store_of_version_0_1_is_read_and_resumed(tmp_path, scenario, commanded) -> None:
    path = tmp_path / "s.zarr"
    fill(path, scenario, commanded, range(2))
    for name in ("joint_velocity", "joint_torque"):  # it had none
        shutil.rmtree(path / name)
    old = json.loads(scenario.resolved())
    section = old["reconstruction"]
    unused = {"subsets": None, "regularisation": 1e-4, "weighting": "uniform", "tv_steps": 10}
    section |= {"engine": "twinct", "window": "ramp", "nonnegative": None} | unused
    rewritten(path, format=1, digest="of then", digests=None, scenario=json.dumps(old))
    assert ScanStore(path).scenario == scenario
    store = ScanStore.resume(path, image_digests(scenario))
    assert store.acquired == 2
    with pytest.raises(ScanExistsError, match="another scenario"):
        ScanStore.resume(path, image_digests(harder(scenario)))
    assert fill(path, scenario, commanded, range(2, VIEWS)).read().joints.shape == (VIEWS, 2)


def test_what_is_believed_is_no_part_of_a_scan(tmp_path, scenario, commanded) -> None:
    path = tmp_path / "s.zarr"
    fill(path, scenario, commanded, range(2))
    for other in ({"name": "other"}, {"seed": 77}):
        digests = image_digests(scenario.model_copy(update=other))
        assert ScanStore.resume(path, digests).acquired == 2
    assert not (path / "believed").exists()


@pytest.mark.parametrize(
    ("name", "values", "what"),
    [
        ("transmission", np.nan, "transmission of view 3 is not finite"),
        ("joints", np.inf, "joints of view 3 is not finite"),
        ("clearance_mm", -np.inf, "clearance_mm of view 3 is not finite"),
        ("executed/source", np.nan, "executed/source of view 3 is not finite"),
        ("executed/source", (0, 0, -500), "view 3 points away from the source"),
    ],
)
def test_values_that_no_scan_has_are_named_whoever_vouches_for_them(
    tmp_path, scenario, commanded, monkeypatch, name, values, what
) -> None:
    """Found by tools/fuzz stores: damage with digests made anew, or from before there were any."""
    path = tmp_path / "s.zarr"
    fill(path, scenario, commanded, range(VIEWS)).read()
    monkeypatch.setattr(CheckedStore, "_check", lambda *_: None)
    zarr.open_array(str(path / name), mode="r+")[3] = values
    with pytest.raises(InputError, match=f"s.zarr: .*{what}"):
        ScanStore(path).read()


@pytest.mark.parametrize("names", [NAMES, ()])
def test_no_array_has_chunks_of_size_0(tmp_path, scenario, commanded, names) -> None:
    """Zarr 3 asks for chunks of 1 at least; a scan without arms has values of no joints."""
    ScanStore.create(tmp_path / "s.zarr", scenario, commanded, names, 9)
    files = {file.parent.name: file.read_text() for file in tmp_path.rglob("zarr.json")}
    arrays = {name: json.loads(text) for name, text in files.items() if "chunk_grid" in text}
    assert arrays["joints"]["shape"] == [VIEWS, len(names)]
    for name, array in arrays.items():
        assert 0 not in array["chunk_grid"]["configuration"]["chunk_shape"], name


def test_chunks_of_size_0_in_older_stores_are_read_as_chunks_of_1(
    tmp_path, scenario, commanded, monkeypatch
) -> None:
    """As twinct 1.0.0 wrote a scan without arms: whole, and goes on from where it stopped."""
    path, joints = tmp_path / "s.zarr", ("joints", "joint_velocity", "joint_torque")
    monkeypatch.setattr("twinct.scan.layout.FORMAT", 4)
    sealed_before = write_frame_manifest

    def older(group: Any, path: Path, *rest: Any) -> None:
        for name in joints:
            file = path / name / "zarr.json"
            data = json.loads(file.read_text())
            data["chunk_grid"]["configuration"]["chunk_shape"] = [1, 0]
            file.write_text(json.dumps(data))
        sealed_before(group, path, *rest)

    monkeypatch.setattr("twinct.scan.layout.write_frame_manifest", older)
    store = ScanStore.create(path, scenario, commanded, (), 9)

    def without_joints(index: int) -> Any:
        image, reached = view(index)
        none = np.zeros(0)
        return image, replace(reached, joint_names=(), position=none, velocity=none, effort=none)

    for index in range(VIEWS):
        store = ScanStore.resume(path, image_digests(scenario))
        store.write(index, *without_joints(index))
    assert store.vouched and not frame_damage(path) and not view_damage(path)
    assert ScanStore(path).read().joints.shape == (VIEWS, 0)


def test_metadata_without_end_are_told(tmp_path, scenario, commanded) -> None:
    path = tmp_path / "s.zarr"
    fill(path, scenario, commanded, range(1))
    monstrous = path / "raw"
    monstrous.mkdir()
    (monstrous / "zarr.json").write_text('{"zarr_format": ' + "1" * 5000)
    with pytest.raises(InputError, match=r"cannot be read: Exceeds the limit"):
        ScanStore(path)


def test_a_pipe_in_a_store_without_digests_is_not_waited_for(tmp_path) -> None:
    for name in ("status", "joints"):
        (tmp_path / name).mkdir()
        os.mkfifo(tmp_path / name / "zarr.json")
    (tmp_path / "status" / "c.0").write_bytes(b"\1")
    assert view_damage(tmp_path) == []


def test_an_interruption_waits_until_a_view_is_written(
    tmp_path, scenario, commanded, monkeypatch
) -> None:
    """Zarr would go on writing in its own thread."""
    store = fill(tmp_path / "s.zarr", scenario, commanded, range(2))
    put = ScanStore._put

    def interrupted(self: ScanStore, *columns: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        put(self, *columns)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(ScanStore, "_put", interrupted)
        store.write(2, *view(2))
    signal.signal(signal.SIGINT, before)
    assert store.acquired == 3
    whole = fill(tmp_path / "whole.zarr", scenario, commanded, range(3))
    assert contents(store.path) == contents(whole.path)
