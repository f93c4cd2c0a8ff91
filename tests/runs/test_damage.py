"""A store that says what it cannot be, and what is no file of it: a message, nothing is lost."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from twinct.core.errors import DamagedError, InputError
from twinct.runs import Run, verify
from twinct.scan import ScanStore, image_digests
from twinct.scan.damage import clear_paths
from twinct.scan.manifest import FRAME_FILE, digest_of, sealed, unsealed

STATE, IMAGE = "state/c.4.0", "transmission/c.2.0.0"


@pytest.fixture
def path(finished: Run, tmp_path: Path) -> Path:
    return shutil.copytree(finished.paths.scan, tmp_path / "scan.zarr")


def rewritten(path: Path, file: str, change: Callable[[Any], object]) -> None:
    """Change metadata, and the manifest with it."""
    told = json.loads((path / file).read_text())
    change(told)
    (path / file).write_text(json.dumps(told))
    known = unsealed((path / FRAME_FILE).read_bytes())
    now = {name: digest_of((path / name).read_bytes()) for name in known}
    (path / FRAME_FILE).write_bytes(sealed(now))


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("format", 99, "the scan store has format 99; this twinct reads"),
        ("format", [4], r"the scan store has format \[4\]"),
        ("scenario", None, "attributes.scenario: missing, expected a string"),
        ("scenario", "{", "attributes.scenario: not a JSON mapping"),
        ("scenario", '{"detector": 5}', "detector"),
        ("joint_names", "all", "attributes.joint_names: str, expected a list"),
        ("joint_names", ["one"], "there are 1 joints"),
        ("digests", {"images": 5}, "names and digests must be strings"),
    ],
)
def test_attributes_are_looked_at(path: Path, key: str, value: object, words: str) -> None:
    rewritten(path, "zarr.json", lambda told: told["attributes"].update({key: value}))
    with pytest.raises(InputError, match=words):
        _ = ScanStore(path).scenario
    assert any(str(path) in problem for problem in verify(path).problems)


@pytest.mark.parametrize(
    ("array", "key", "value"),
    [
        ("joints", "shape", [10**9, 12]),
        ("transmission", "data_type", "float64"),
        ("executed/u", "codecs", [{"name": "nothing"}]),
        ("executed/object", "shape", [10, 2]),
        ("commanded/source_quat", "zarr_format", "three"),
        ("status", "fill_value", "x"),
        ("state", "node_type", "group"),
    ],
)
def test_arrays_are_looked_at(path: Path, array: str, key: str, value: object) -> None:
    rewritten(path, f"{array}/zarr.json", lambda told: told.update({key: value}))
    with pytest.raises(InputError, match=str(path)):
        ScanStore(path)
    assert verify(path).problems


def test_images_of_another_size_than_the_scenario_says(path: Path) -> None:
    def change(told: Any) -> None:
        scenario = json.loads(told["attributes"]["scenario"])
        scenario["detector"]["rows"] *= 2
        told["attributes"]["scenario"] = json.dumps(scenario)

    rewritten(path, "zarr.json", change)
    with pytest.raises(InputError, match=r"its scenario has \(48, 32\) pixels, but its images"):
        ScanStore(path).read()


def test_no_file_in_the_place_of_one_is_damage_that_is_mended(path: Path, finished: Run) -> None:
    for place in (STATE, IMAGE, "status/c.7"):
        (path / place).unlink()
    os.mkfifo(path / STATE)
    os.mkfifo(path / "status/c.7")
    (path / IMAGE).symlink_to(path / "transmission/c.3.0.0")
    told = "\n".join(verify(path).problems)
    for words in (
        "view 4, state: is a named pipe",
        "view 2, transmission: changed",
        "view 7, status",
    ):
        assert words in told
    with pytest.raises(DamagedError, match="view 7, status: changed"):
        ScanStore(path).read()
    ScanStore.resume(path, image_digests(finished.scenario))
    assert not any(os.path.lexists(path / place) for place in (STATE, IMAGE, "status/c.7"))
    assert (path / "transmission/c.3.0.0").is_file()


def test_manifests_of_two_views_exchanged_are_told(path: Path, finished: Run) -> None:
    """Each tells of whole files, but not of its own view's."""
    one, other = path / "manifest/views/c.1.0", path / "manifest/views/c.5.0"
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)
    told = verify(path).problems
    for view in (1, 5):
        assert any(f"view {view}, manifest/views: changed" in words for words in told)
    ScanStore.resume(path, image_digests(finished.scenario))
    assert not one.exists() and not other.exists()


def vouch_for_what_is_there(path: Path) -> None:
    known = [name for name in unsealed((path / FRAME_FILE).read_bytes()) if (path / name).exists()]
    now = {name: digest_of((path / name).read_bytes()) for name in known}
    (path / FRAME_FILE).write_bytes(sealed(now))


def test_an_array_in_the_place_of_the_plan_is_told(path: Path) -> None:
    shutil.rmtree(path / "plan")
    shutil.copytree(path / "joints", path / "plan")
    vouch_for_what_is_there(path)
    with pytest.raises(InputError, match="plan: found an array, expected a group"):
        _ = ScanStore(path).plan


def test_a_plan_larger_than_any_is_told_before_it_is_read(path: Path) -> None:
    header = path / "plan/state/zarr.json"
    told = json.loads(header.read_text())
    told["shape"][2] = 2**31
    header.write_text(json.dumps(told))
    vouch_for_what_is_there(path)
    with pytest.raises(InputError, match="plan: its arrays claim"):
        _ = ScanStore(path).plan


def test_an_array_of_thousands_of_dimensions_is_told(path: Path) -> None:
    """A chunk's name would be longer than any file's."""
    header = path / "state/zarr.json"
    told = json.loads(header.read_text())
    told["shape"] += [1] * 3000
    header.write_text(json.dumps(told))
    shutil.rmtree(path / "manifest")
    assert verify(path).problems


def test_a_folder_in_a_status_place_is_damage(path: Path) -> None:
    (path / "status/c.3").unlink()
    (path / "status/c.3").mkdir()
    with pytest.raises(DamagedError, match="view 3, status: changed"):
        ScanStore(path).read()


def test_a_folder_in_the_way_is_left_to_whoever_made_it(path: Path, finished: Run) -> None:
    (path / STATE).unlink()
    (path / STATE).mkdir()
    (path / STATE / "mine").touch()
    (path / IMAGE).unlink()
    with pytest.raises(DamagedError, match=r"c\.4\.0: a folder stands in the way: move it"):
        ScanStore.resume(path, image_digests(finished.scenario))
    assert (path / STATE / "mine").exists() and (path / "status/c.4").exists()


def test_a_file_where_a_folder_has_to_be_is_left_too(path: Path) -> None:
    shutil.rmtree(path / "joints")
    (path / "joints").write_text("mine")
    with pytest.raises(DamagedError) as error:
        ScanStore(path)
    with pytest.raises(DamagedError, match="joints: a file stands in the way: move it"):
        clear_paths(path, error.value.damages)
    assert (path / "joints").read_text() == "mine"


def test_whatever_is_none_of_the_stores_is_listed(path: Path, finished: Run) -> None:
    (path / "state" / "c.77.0").touch()
    (path / "c").touch()
    (path / "joints" / "link").symlink_to("/nowhere")
    os.mkfifo(path / "pipe")
    found = verify(path)
    assert found.problems == ()
    listed = [str(file.relative_to(path)) for file in found.unknown]
    assert listed == ["c", "joints/link", "pipe", "state/c.77.0"]
    ScanStore.resume(path, image_digests(finished.scenario))
    assert all(os.path.lexists(file) for file in found.unknown)
