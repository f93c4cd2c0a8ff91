"""Scans of grey parts, where there is no gVXR."""

from pathlib import Path

import nibabel
import numpy as np
import pytest
import yaml
from test_mesh_scan import SMALL, twinct, without_gvxr

from twinct.runs import simulate
from twinct.scan import ScanStore
from twinct.scenario import load_scenario

__all__ = ["without_gvxr"]

ROD = "{name: rod, shape: {kind: cylinder, radius_mm: 2, height_mm: 30}, material: titanium}"


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """A scenario of one grey part: a ball of soft tissue with a bone core, 40 mm wide, in air."""
    x, y, z = np.indices((26, 26, 26)) * 2.0 - 25.0
    squared = x * x + y * y + z * z
    hu = np.where(squared < 20**2, 40.0, -1000.0) + np.where(squared < 8**2, 900.0, 0.0)
    image = nibabel.Nifti1Image(hu.astype(np.int16), np.diag([2.0, 2.0, 2.0, 1.0]))
    nibabel.save(image, image_path := tmp_path / "ball.nii.gz")
    shape = {"kind": "volume", "path": image_path.name}
    patient = {"name": "patient", "shape": shape, "material": "bone"}
    keys = {"extends": str(SMALL), "specimen": {"parts": [patient]}, "trajectory": {"views": 2}}
    (tmp_path / "grey.yaml").write_text(yaml.safe_dump(keys), encoding="utf-8")
    return tmp_path / "grey.yaml"


@pytest.mark.usefixtures("without_gvxr")
def test_a_scan_of_grey_parts_needs_no_engine(scan: Path) -> None:
    scenario = load_scenario(scan, {"cell": {"kind": "gantry"}})
    images = [simulate(scenario).transmission for _ in range(2)]
    assert images[0].min() < 0.5 and images[0].max() > 0.99
    assert np.array_equal(*images)


@pytest.mark.tutorial
@pytest.mark.process
@pytest.mark.usefixtures("without_gvxr")
def test_both_links_give_the_same_images_of_a_patient_with_a_rod(
    scan: Path, tmp_path: Path
) -> None:
    keys = yaml.safe_load(scan.read_text(encoding="utf-8"))
    keys["specimen"]["parts"].append(yaml.safe_load(ROD))
    keys["xray"] = {"engine": "mesh"}
    scan.write_text(yaml.safe_dump(keys), encoding="utf-8")
    out = tmp_path / "out"
    done = twinct("run", scan, "--out", out, "--link", "ros2")
    assert done.returncode == 0, done.stderr
    remote = ScanStore(out / "scan.zarr").read().transmission
    local = simulate(load_scenario(scan)).transmission
    assert local.min() < 0.3
    assert np.array_equal(local, remote)


@pytest.mark.tutorial
@pytest.mark.process
@pytest.mark.usefixtures("without_gvxr")
def test_both_links_give_the_same_images_of_a_patient_who_breathes(
    scan: Path, tmp_path: Path
) -> None:
    keys = yaml.safe_load(scan.read_text(encoding="utf-8"))
    chest = {"dome_mm": [0, 5, 0], "reach_mm": [40, 40], "half_axes_mm": [30, 30]}
    chest |= {"diaphragm_mm": 4, "front_mm": 0, "period_s": 3.1, "irregularity": 0.2}
    keys["specimen"]["motion"] = {"kind": "breathing", **chest}
    keys["source"] = {"exposure_ms": 40, "motion_samples": 2}
    scan.write_text(yaml.safe_dump(keys), encoding="utf-8")
    out = tmp_path / "out"
    done = twinct("run", scan, "--out", out, "--link", "ros2")
    assert done.returncode == 0, done.stderr
    remote = ScanStore(out / "scan.zarr").read()
    local = simulate(load_scenario(scan)).transmission
    assert np.array_equal(local, remote.transmission)
    still = simulate(load_scenario(scan, {"specimen.motion": None})).transmission
    assert np.abs(still - local).max() > 0.01
