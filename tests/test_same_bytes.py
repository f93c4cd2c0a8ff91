"""Projections, geometries and volumes keep their bytes, whatever is rebuilt around them.

``same_bytes/digests.json`` holds what runs wrote before; to run this file as a program takes it
anew, and the commit that does says what changed and why. Compiled kernels and software OpenGL give
other last bits on another processor: there, samples of every array are compared.

Over ROS 2 only the scan is made: a volume is made of what is stored, by whatever link it came.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest
import tifffile
import zarr
from llvmlite.binding import get_host_cpu_features, get_host_cpu_name

from twinct import run
from twinct.runs import acquire_to_store
from twinct.scan import ScanStore, SimulationBuilder
from twinct.scenario import load_scenario

pytestmark = pytest.mark.process

HERE = Path(__file__).parent
KEPT = HERE / "same_bytes" / "digests.json"
SMALL = ("titanium", "blur", "lag")
CTSIMU = Path(os.environ.get("CTSIMU_DATA", HERE.parents[1] / "shared/data/ctsimu"))
EXAMPLE = "02_simple_scan_circular"
ARRAYS = (
    "transmission",
    *(f"{kind}/{name}" for kind in ("commanded", "executed")
      for name in ("source", "detector", "u", "v", "source_quat", "detector_quat")),
)  # fmt: skip
OF_THE_SCAN = ("volume", "affine")
"""Arrays that are made of the others."""
SAMPLES = 24
TOLERANCE = 1e-4
"""Of the largest value, between processors: float32 sums in another order, and Mesa's vectors."""


def machine() -> dict[str, str]:
    """What the last bits depend on."""
    found = {name: version(name) for name in ("numba", "numpy", "scipy", "gvxr", "mujoco", "mink")}
    status = Path("/var/lib/dpkg/status")
    text = status.read_text(encoding="utf-8", errors="replace") if status.exists() else ""
    mesa = re.search(r"^Package: libgl1-mesa-dri\n(?:.+\n)*?Version: (.+)$", text, re.MULTILINE)
    # Machines of one processor's name may offer other instructions, and kernels use them all.
    features = hashlib.sha256(get_host_cpu_features().flatten().encode()).hexdigest()
    processor = {"cpu": get_host_cpu_name(), "features": features}
    return found | processor | {"mesa": mesa[1] if mesa else "unknown"}


def twinct(*arguments: str) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "twinct", *arguments], capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr


def scanned(name: str, link: str, folder: Path, builder: SimulationBuilder) -> dict[str, Any]:
    """Return digest and samples of every array of a run, or over ROS 2 of a scan."""
    out = folder / f"{name}-{link}"
    if link == "ros2":
        from twinct.link import ros_rigs

        out.mkdir()
        acquire_to_store(builder, out / "scan.zarr", ros_rigs(out / "logs"), resume=False)
        return described_scan(out / "scan.zarr")
    with pytest.MonkeyPatch.context() as patch:
        # The page is the other tests' matter, and takes longest.
        patch.setattr("twinct.runs.reporting.draw_pictures", lambda _: {})
        patch.setattr("twinct.runs.reporting.write_report", lambda path, *_: path.touch())
        done = run(builder.scenario, out, link="local", builder=builder)
    volume: Any = nibabel.loadsave.load(done.paths.volume)
    arrays = {"volume": np.asarray(volume.dataobj), "affine": np.asarray(volume.affine)}
    return described_scan(done.paths.scan) | {key: described(arrays[key]) for key in arrays}


def described_scan(path: Path) -> dict[str, Any]:
    store: Any = zarr.open_group(str(path), mode="r")
    arrays = {name: np.asarray(store[name][:]) for name in ARRAYS} | believed(path)
    return {name: described(values) for name, values in arrays.items()}


def believed(store: Path) -> dict[str, np.ndarray]:
    """Source, panel centre and axes, as a scan holds those of the other geometries."""
    poses = ScanStore(store).provenance.reported.poses
    axes = np.array([pose.rotation for pose in poses.detector])
    return {
        "believed/source": np.array([pose.position for pose in poses.source]),
        "believed/detector": np.array([pose.position for pose in poses.detector]),
        "believed/u": axes[:, :, 0],
        "believed/v": axes[:, :, 1],
        "believed/source_quat": np.array([pose.quat for pose in poses.source]),
        "believed/detector_quat": np.array([pose.quat for pose in poses.detector]),
    }


def rendered(folder: Path) -> dict[str, Any]:
    """Digest and samples of the projections of a CTSimU example."""
    twinct("ctsimu", "render", str(CTSIMU / EXAMPLE / f"{EXAMPLE}.json"), "--out", str(folder))
    files = sorted(folder.glob("*.tif"))
    return {file.stem: described(tifffile.imread(file)) for file in files}


def described(values: np.ndarray) -> dict[str, Any]:
    values = np.ascontiguousarray(values)
    places = np.random.default_rng(0).integers(0, values.size, SAMPLES)
    return {
        "sha256": hashlib.sha256(values.tobytes()).hexdigest(),
        "shape": list(values.shape),
        "largest": float(np.abs(values).max()),
        "samples": values.ravel()[places].astype(float).tolist(),
    }


def same(found: dict[str, Any], name: str, without: tuple[str, ...] = ()) -> None:
    """Raise an assertion for the first array that is another."""
    kept = json.loads(KEPT.read_text())
    assert found.keys() == kept[name].keys() - set(without)
    if machine() == kept["machine"]:
        changed = [key for key in found if found[key]["sha256"] != kept[name][key]["sha256"]]
        assert not changed, f"{name}: other bytes in {changed}"
        return
    for key, values in found.items():
        expected = kept[name][key]
        assert values["shape"] == expected["shape"], f"{name}: {key}"
        allowed = TOLERANCE * expected["largest"]
        np.testing.assert_allclose(
            values["samples"], expected["samples"], rtol=0, atol=allowed, err_msg=f"{name}: {key}"
        )


def builder_of(name: str) -> SimulationBuilder:
    place = HERE / "same_bytes" if name in SMALL else HERE.parent / "scenarios"
    return SimulationBuilder(load_scenario(place / f"{name}.yaml"))


@pytest.fixture(scope="module")
def builder() -> Callable[[str], SimulationBuilder]:
    """Return the maker of a scenario's builder: both links share it, it builds a specimen once."""
    return cache(builder_of)


@pytest.mark.tutorial
@pytest.mark.parametrize("name", [*SMALL, "demo"])
def test_runs(name: str, tmp_path: Path, builder: Callable[[str], SimulationBuilder]) -> None:
    same(scanned(name, "local", tmp_path, builder(name)), name)


@pytest.mark.tutorial
@pytest.mark.ros
@pytest.mark.parametrize("name", ["lag", "demo"])
def test_scans_over_ros(
    name: str, tmp_path: Path, builder: Callable[[str], SimulationBuilder]
) -> None:
    """Take the demo and a scan with lag; other physics: ``link/test_rig_contract.py``."""
    same(scanned(name, "ros2", tmp_path, builder(name)), name, without=OF_THE_SCAN)


@pytest.mark.data
@pytest.mark.skipif(not CTSIMU.is_dir(), reason="needs BAM's CTSimU examples (CTSIMU_DATA)")
def test_ctsimu_example(tmp_path: Path) -> None:
    same(rendered(tmp_path), EXAMPLE)


def take() -> None:
    """Write down what the present code gives, over both links."""
    kept: dict[str, Any] = {"machine": machine()}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in (*SMALL, "demo"):
            builder = builder_of(name)
            kept[name] = scanned(name, "local", folder, builder)
            other = scanned(name, "ros2", folder, builder)
            differ = [key for key in other if other[key] != kept[name][key]]
            assert not differ, f"{name}: the links differ in {differ}"
        kept[EXAMPLE] = rendered(folder / "example")
    KEPT.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    take()
