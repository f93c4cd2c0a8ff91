"""A value of the wrong kind is refused by name, with what came and what is allowed."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twinct
from twinct import Volume, compare, evaluate, load_scan, load_scenario, needs, reconstruct, run
from twinct import simulate as simulated
from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.geometry import VolumeGrid

SMALL = {
    "trajectory.views": 2,
    "detector": {"columns": 8, "rows": 6, "pixel_pitch_mm": 40},
    "reconstruction.grid": {"voxels": 4, "voxel_mm": 40},
    "xray.engine": "mesh",
}
ARRAY = np.zeros((4, 5, 6), np.float32)


@pytest.fixture(scope="module")
def scan() -> Any:
    return simulated("circle_gantry", **SMALL)


@pytest.fixture(scope="module")
def volume() -> Volume:
    return Volume(ARRAY, VolumeGrid(ARRAY.shape, 1.0))


def _said(call: Any, *args: Any, **keys: Any) -> str:
    with pytest.raises(InputError) as caught:
        call(*args, **keys)
    return str(caught.value)


def test_an_array_is_no_volume(scan: Any) -> None:
    said = _said(evaluate, scan, ARRAY)
    assert said.startswith("evaluate: volume must be a Volume, as reconstruct(SCAN)")
    assert said.endswith("but is an array of shape (4, 5, 6)")


def test_a_volume_is_no_scan(volume: Volume) -> None:
    assert _said(evaluate, volume, volume).endswith("but is a Volume")


@pytest.mark.parametrize("path", ["out/demo", Path("out/demo")])
def test_a_path_is_no_scan(path: str | Path) -> None:
    said = _said(reconstruct, path)
    assert "load_scan(FOLDER)" in said and "'out/demo'" in said


def test_a_number_is_no_list_of_views(scan: Any) -> None:
    said = _said(scan.show, None, 3)
    assert said == "show: views must be several whole numbers, such as [0, 5] or None, but is 3"


@pytest.mark.parametrize("value", ["part.stl", Path("part.stl"), ARRAY])
def test_a_path_or_an_array_is_no_specimen(value: Any) -> None:
    said = _said(simulated, "circle_gantry", specimen=value)
    assert "specimen: must be a closed mesh, such as trimesh.load('part.stl'), a Volume" in said
    assert "part.stl'" in said.rpartition("but is")[2] or "shape (4, 5, 6)" in said


@pytest.mark.parametrize(
    ("call", "args", "words"),
    [
        (simulated, (3,), "scenario must be a Scenario"),
        (run, ("demo", 3), "out must be a text or a path, but is 3"),
        (load_scan, (None,), "path must be a text or a path, but is None"),
        (load_scenario, ("demo", 3), "values by dotted key"),
        (load_scenario, ("demo", "seed=2"), "but is the text 'seed=2'"),
        (compare, ("out/a",), "several folders"),
        (needs, (["demo"],), "but is a list of 1 item"),
    ],
)
def test_other_functions_name_the_argument(call: Any, args: tuple[Any, ...], words: str) -> None:
    assert words in _said(call, *args)


def test_needs_takes_the_name_of_a_scenario() -> None:
    assert needs("circle_gantry").keys() == needs(load_scenario("circle_gantry")).keys()


def test_numbers_of_numpy_and_missing_arguments_are_pythons_own() -> None:
    @kinds_checked
    def take(one: int, two: float = 0.0) -> float:
        return one + two

    number: Any = np.int64(2)
    assert take(number, 0.5) == 2.5
    assert _said(take, True) == "take: one must be a whole number, but is True"
    with pytest.raises(TypeError, match="unexpected keyword argument 'three'"):
        take(1, three=2)  # pyright: ignore[reportCallIssue]
    with pytest.raises(TypeError, match="missing 1 required"):
        take()  # pyright: ignore[reportCallIssue]


def test_every_public_function_is_checked() -> None:
    public = [getattr(twinct, name) for name in twinct.__all__]
    functions = [one for one in public if inspect.isfunction(one)]
    bare = [one.__name__ for one in functions if not hasattr(one, "__wrapped__")]
    assert bare == ["run_study"]  # takes mappings of any content
