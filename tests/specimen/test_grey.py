"""Grey parts: CT volumes as mixtures, in place, with their skin, labels and displaced voxels."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
import pytest
from ct_files import Truth, save, slices
from grey_head import SHAPE, SPACING, grid_of_ct, head, labels, write
from pydantic import ValidationError

from twinct.core.errors import SpecimenError
from twinct.geometry import Pose, VolumeGrid
from twinct.recon.volume import Volume
from twinct.scenario import Specimen, load_scenario
from twinct.specimen import BuiltSpecimen, build_specimen
from twinct.specimen.built_file import load_built, save_built
from twinct.specimen.grey_part import GreyPart, add_means
from twinct.specimen.materials import BUILT_IN
from twinct.specimen.volumes import read_ct

KEV = 71.6
DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"


def section(path: Path, more: tuple[dict[str, Any], ...] = (), **keys: Any) -> Specimen:
    shape = {"kind": "volume", "path": str(path), "centre": False, "keep": "body"} | keys
    reference = shape.pop("reference", "")
    parts = [{"name": "head", "shape": shape}, *more]
    return Specimen.model_validate_json(
        json.dumps({"parts": parts, "reference": reference}), strict=True
    )


def build(path: Path, *more: dict[str, Any], **keys: Any) -> BuiltSpecimen:
    return build_specimen(section(path, more, **keys))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return write(tmp_path / "head.nii", head())


def grey_of(built: BuiltSpecimen) -> GreyPart:
    (part,) = built.mixtures
    return part


def mu_of(hu: float) -> float:
    return BUILT_IN["water"].mu_per_mm(KEV) * (1 + hu / 1000)


def test_truth_on_the_grid_of_the_ct_is_its_attenuation(file: Path) -> None:
    """Inside uniform tissue, the truth is that of the HU; the couch is gone."""
    truth = build(file).truth(grid_of_ct(), KEV)
    hu = head().values.transpose(2, 1, 0)
    assert truth[14, 20, 15] == pytest.approx(mu_of(40), rel=1e-3)
    assert truth[14, 20, 27] == pytest.approx(mu_of(1000), rel=1e-3)
    assert hu[14, 1, 19] == 200 and not truth[:, :4].any()
    kept = build(file, keep="all").truth(grid_of_ct(), KEV)
    assert kept[14, 1:3, 20].mean() > 0.5 * mu_of(200)


def linear(points: np.ndarray, values: np.ndarray, grid: VolumeGrid) -> np.ndarray:
    from scipy.ndimage import map_coordinates

    index = (grid.world_from_grid.inverse().apply(points) - grid.first_voxel_mm) / grid.voxel
    return map_coordinates(values, index.T[::-1], order=1, mode="constant")


def test_means_on_a_turned_grid(figure: Callable[[str], None]) -> None:
    """Means of the linear field over voxels, against 10 x 10 x 10 points each."""
    rng = np.random.default_rng(3)
    of = VolumeGrid((6, 7, 8), (1.0, 1.5, 2.0), Pose.from_euler((1, 2, 3), (10, 20, 30)))
    values = np.pad(rng.random((4, 5, 6), dtype=np.float32), 1)
    grid = VolumeGrid((5, 6, 4), (2.0, 1.7, 2.3), Pose.from_euler((0, 1, 2), (-20, 5, 50)))
    place = Pose.from_euler((0.3, -0.2, 0.1), (3, 2, 1))
    found = np.zeros(grid.shape, np.float32)
    add_means(values, of, grid, place, found)
    fine = VolumeGrid(np.array(grid.shape) * 10, grid.voxel / 10, grid.world_from_grid)
    x, y, z = fine.axes()
    local = np.stack(np.meshgrid(z, y, x, indexing="ij"), axis=-1)[..., ::-1].reshape(-1, 3)
    points = place.inverse().apply(grid.world_from_grid.apply(local))
    exact = linear(points, values, of).reshape(5, 10, 6, 10, 4, 10).mean(axis=(1, 3, 5))
    assert exact.max() > 0.3
    error = np.sqrt(np.mean((found - exact) ** 2)) / exact.std()
    figure(f"means of white noise on a turned grid: {100 * error:.1f} % of its deviation")
    assert error < 0.02  # white noise has the largest errors
    assert found.sum() == pytest.approx(exact.sum(), rel=5e-3)


TABLE = {
    "kind": "table",
    "rows": [
        {"hu": -1000, "density_g_cm3": 0, "material": "water"},
        {"hu": 40, "density_g_cm3": 1.04, "material": "water"},
        {"hu": 1000, "density_g_cm3": 1.6, "material": "bone"},
    ],
}


def test_sharp_edges_have_materials_of_the_rows(file: Path, tmp_path: Path) -> None:
    """The truth on a turned grid, against points that are each of one row."""
    built = build(file, calibration=TABLE, edges="sharp")
    field = grey_of(built).field
    assert [m.density_g_cm3 for m in field.materials] == [1.04, 1.6]
    grid = VolumeGrid((9, 9, 9), 5.0, Pose.from_euler((1, 2, 3), (10, 20, 30)))
    truth = built.truth(grid, KEV)
    fine = VolumeGrid(np.array(grid.shape) * 10, grid.voxel / 10, grid.world_from_grid)
    x, y, z = fine.axes()
    local = np.stack(np.meshgrid(z, y, x, indexing="ij"), axis=-1)[..., ::-1].reshape(-1, 3)
    points = fine.world_from_grid.apply(local)
    shares = [linear(points, one, field.grid) for one in np.moveaxis(field.amounts, -1, 0)]
    largest = np.argmax([*shares, 1 - np.sum(shares, axis=0)], axis=0)
    mus = np.array([*(m.mu_per_mm(KEV) for m in field.materials), 0.0])
    exact = mus[largest].reshape(9, 10, 9, 10, 9, 10).mean(axis=(1, 3, 5))
    assert np.ptp(exact) > 0.9 * mus[1]
    assert np.sqrt(np.mean((truth - exact) ** 2)) < 0.01 * mus[1]
    save_built(built, tmp_path / "built.npz")
    told = section(file, calibration=TABLE, edges="sharp")
    again = load_built(told, tmp_path / "built.npz")
    assert again.digest == built.digest != build(file, calibration=TABLE).digest
    with pytest.raises(ValidationError, match="sharp needs a calibration of kind table"):
        section(file, edges="sharp")


def test_a_mesh_displaces_voxels_by_fractions(file: Path) -> None:
    rod = {"shape": {"kind": "cylinder", "radius_mm": 2.3, "height_mm": 12}, "material": "titanium"}
    built = build(file, rod | {"position_mm": [-3.1, 0.4, 0.2]})
    plain = grey_of(build(file))
    grey = grey_of(built)
    lost = (plain.field.amounts - grey.field.amounts).sum(axis=(0, 1, 2))
    cell = SPACING.prod()
    whole = plain.field.mu_per_mm(KEV) - grey.field.mu_per_mm(KEV)
    assert whole.sum() * cell == pytest.approx(np.pi * 2.3**2 * 12 * mu_of(40), rel=6e-3)
    assert lost.sum() > 0
    truth = built.truth(grid_of_ct(), KEV).sum() * cell
    rod_alone = BUILT_IN["titanium"].mu_per_mm(KEV) * np.pi * 2.3**2 * 12
    without = build(file).truth(grid_of_ct(), KEV).sum() * cell
    assert truth == pytest.approx(without - whole.sum() * cell + rod_alone, rel=1e-3)
    cover = {"shape": {"kind": "box", "size_mm": [90, 90, 90]}, "material": "titanium"}
    with pytest.raises(SpecimenError, match="part 'head' is empty: later parts cover it"):
        build(file, cover)


def test_every_orientation_gives_the_same_body(file: Path, tmp_path: Path) -> None:
    """Indices in another order, a turned volume, and the same as DICOM."""
    wanted = build(file).truth(grid_of_ct(), KEV)
    truth = head()
    flip = np.array([[0, -1, 0, SHAPE[0] - 1.0], [0, 0, 1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
    values = truth.values.transpose(2, 0, 1)[:, ::-1, :]
    turned = write(tmp_path / "turned.nii", Truth(values, truth.affine @ flip))
    assert build(turned).truth(grid_of_ct(), KEV) == pytest.approx(wanted, abs=1e-6)
    save(tmp_path / "series", slices(truth))
    assert build(tmp_path / "series").truth(grid_of_ct(), KEV) == pytest.approx(wanted, abs=1e-6)


def test_a_tilted_gantry_is_sheared_right(file: Path, tmp_path: Path) -> None:
    """Slices that are shifted by a tilt of 20 degrees, with the body at the same place."""
    shift = np.tan(np.radians(20)) * SPACING[2]
    affine = head().affine.copy()
    affine[1, 2] = shift
    affine[1, 3] -= 14 * shift
    i, j, k = np.indices(SHAPE)
    y = (j - 20) * SPACING[1] + (k - 14) * shift
    x, z = (i - 19) * SPACING[0], (k - 14) * SPACING[2]
    values = np.full(SHAPE, -1000.0)
    values[x * x + y * y + z * z < 15**2] = 40.0
    values[(np.abs(x - 8) <= 2) & (np.abs(y) <= 4) & (np.abs(z) <= 6)] = 1000.0
    images = slices(Truth(values, affine))
    for image in images:
        image.GantryDetectorTilt = "20"
    save(tmp_path / "tilted", images)
    built = build(tmp_path / "tilted")
    grid = grey_of(built).field.grid
    assert grid.world_from_grid.rotation == pytest.approx(np.eye(3), abs=1e-9)
    assert grid.voxel == pytest.approx(SPACING)
    straight, wanted = built.truth(grid_of_ct(), KEV), build(file).truth(grid_of_ct(), KEV)
    assert np.abs(straight - wanted).mean() < 0.05 * wanted.mean()
    assert straight.sum() == pytest.approx(wanted.sum(), rel=0.02)
    assert built.bounds == pytest.approx(build(file).bounds, abs=2.5)


def test_uneven_slices_are_interpolated_with_the_key(tmp_path: Path) -> None:
    """Every second slice of the upper half is missing, as in many head scans."""
    images = slices(head())
    save(tmp_path / "uneven", [*images[:16], *images[16::2]])
    with pytest.raises(SpecimenError, match="not evenly spaced"):
        build(tmp_path / "uneven")
    image = read_ct(tmp_path / "uneven", "it", interpolate=True)
    save(tmp_path / "even", images[:29])
    whole = read_ct(tmp_path / "even", "it")
    assert image.affine == pytest.approx(whole.affine, abs=1e-6)
    assert image.values.shape == whole.values.shape
    assert image.values[..., :16] == pytest.approx(whole.values[..., :16], abs=0.01)
    mean = (whole.values[..., 16] + whole.values[..., 18]) / 2
    assert image.values[..., 17] == pytest.approx(mean, abs=0.01)
    built = build(tmp_path / "uneven", interpolate_slices=True)
    assert built.bounds == pytest.approx(build(tmp_path / "even").bounds, abs=2)


def test_labels_name_voxels(file: Path, tmp_path: Path) -> None:
    path = labels(tmp_path)
    named = {"path": str(path), "names": {"bone": 7, "brain": 3}}
    built = build(file, labels=named, reference="bone")
    part = grey_of(built)
    assert part.label_names == ("bone", "brain")
    assert built.reference_mu(KEV) == pytest.approx(mu_of(1000), rel=1e-3)
    assert built.reference_name == "bone" and built.reference_part is part
    mask = part.label_on("bone", grid_of_ct(), Pose.identity())
    assert (mask == (head().values == 1000).transpose(2, 1, 0)).all()
    assert grey_of(build(file, labels={"path": str(path)})).label_names == ("label_3", "label_7")
    only = build(file, keep="labelled", labels=named).truth(grid_of_ct(), KEV)
    assert only[14, 20, 27] == pytest.approx(mu_of(1000), rel=1e-3)
    with pytest.raises(ValidationError, match="no part is called 'liver'"):
        build(file, labels=named, reference="liver")
    with pytest.raises(SpecimenError, match="no part or label is called 'liver'"):
        build(file, labels={"path": str(path)}, reference="liver")
    with pytest.raises(SpecimenError, match=r"no voxel of 'liver' \(5\); its labels are \[3, 7\]"):
        build(file, labels=named | {"names": {"liver": 5}})


def test_names_in_the_header_and_in_a_folder(file: Path, tmp_path: Path) -> None:
    image: Any = nibabel.load(labels(tmp_path))
    told = '<Label Key="3">brain</Label><Label Key="7">skull</Label>'
    xml = f"<CaretExtension><LabelTable>{told}</LabelTable></CaretExtension>"
    image.header.extensions.append(nibabel.nifti1.Nifti1Extension(0, xml.encode()))
    nibabel.save(image, tmp_path / "named.nii")
    found = grey_of(build(file, labels={"path": str(tmp_path / "named.nii")}))
    assert found.label_names == ("brain", "skull")
    folder = tmp_path / "segmentations"
    folder.mkdir()
    for name, hu in (("skull", 1000), ("brain", 40), ("liver", 5000)):
        mask = (head().values == hu).astype(float)
        write(folder / f"{name}.nii", Truth(mask, head().affine), "<u1")
    found = grey_of(build(file, labels={"path": str(folder)}))
    assert found.label_names == ("brain", "skull")


def test_file_of_a_built_specimen(file: Path, tmp_path: Path) -> None:
    rod = {"shape": {"kind": "sphere", "radius_mm": 3}, "material": "titanium"}
    named = {"path": str(labels(tmp_path))}
    told = section(file, (rod,), labels=named)
    built = build_specimen(told)
    save_built(built, tmp_path / "built.npz")
    again = load_built(told, tmp_path / "built.npz")
    assert again.digest == built.digest
    assert grey_of(again).label_names == ("label_3", "label_7")
    assert again.materials == built.materials
    other = build(file, rod, labels=named, calibration={"kind": "tissues", "kv": 80})
    assert other.digest != built.digest


def test_cut_faces_and_extension(tmp_path: Path) -> None:
    truth = head()
    cut = Truth(truth.values[..., 8:], truth.affine.copy())
    path = write(tmp_path / "cut.nii", cut)
    part = grey_of(build(path))
    assert [face.name for face in part.cuts] == ["-z"]
    assert part.cuts[0].tissue.shape == part.field.grid.shape[1:]
    assert part.cuts[0].tissue.sum() == pytest.approx((cut.values[..., 0] == 40).sum())
    longer = grey_of(build(path, extend_mm=7.0))
    assert np.ptp(longer.mesh.bounds[:, 2]) == pytest.approx(
        np.ptp(part.mesh.bounds[:, 2]) + 8, abs=0.5
    )


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"surface_hu": 2000}, "no value exceeds surface_hu 2000"),
        ({"calibration": {"kind": "attenuation", "energy_kev": 70}}, "attenuation in 1/mm"),
        (
            {"calibration": {"kind": "table", "rows": [
                {"hu": -1000, "density_g_cm3": 0, "material": "water"},
                {"hu": 0, "density_g_cm3": 1, "material": "phlogiston"}]}},
            "specimen.parts.0.shape.calibration.rows.1.material: unknown material 'phlogiston'",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be(file: Path, keys: dict[str, Any], told: str) -> None:
    with pytest.raises(SpecimenError, match=told):
        build(file, **keys)


def test_zeros_are_no_air_and_a_body_without_air_is_a_box(tmp_path: Path) -> None:
    """Attenuation in other units lies between 0 and some hundreds, as HU may."""
    truth = head()
    where = truth.values > -500
    scaled = Truth(np.where(where, 200.0, 0.0), truth.affine)
    path = write(tmp_path / "scaled.nii", scaled)
    with pytest.raises(SpecimenError, match="of its values are 0, and none is below"):
        build(path)
    mask = tmp_path / "mask.nii"
    nibabel.save(nibabel.Nifti1Image(where.astype(np.uint8), truth.affine), mask)
    assert build(path, mask={"path": str(mask)}).bounds[1, 0] > 0
    assert build(path, above_hu=0.0).bounds[1, 0] > 0
    inner = Truth(np.where(truth.values > 500, 900.0, 40.0), truth.affine)
    size = np.ptp(build(write(tmp_path / "inner.nii", inner)).bounds, axis=0)
    assert size == pytest.approx(np.array(SHAPE) * SPACING, abs=3.5)


def test_attenuation_values(file: Path, tmp_path: Path) -> None:
    """Attenuation at an energy gives what its HU give; without the statement it is refused."""
    truth = head()
    water = BUILT_IN["water"].mu_per_mm(70.0)
    path = write(tmp_path / "mu.nii", Truth(water * (1 + truth.values / 1000), truth.affine), "<f4")
    with pytest.raises(SpecimenError, match="so that they are no HU; if they are attenuation"):
        build(path)
    found = build(path, calibration={"kind": "attenuation", "energy_kev": 70.0})
    same = build(file, calibration={"kind": "tissues", "energy_kev": 70.0})
    assert found.truth(grid_of_ct(), 90.0) == pytest.approx(
        same.truth(grid_of_ct(), 90.0), rel=1e-3
    )


def test_labels_and_masks_on_another_grid(file: Path, tmp_path: Path) -> None:
    affine = head().affine.copy()
    affine[0, 3] += 1.0
    path = labels(tmp_path, affine=affine)
    with pytest.raises(SpecimenError, match="labels .* is on another grid than the CT"):
        build(file, labels={"path": str(path)})
    with pytest.raises(SpecimenError, match="mask .* is on another grid than the CT"):
        build(file, mask={"path": str(path)})


def test_a_volume_of_a_program(file: Path) -> None:
    """An array of HU on a grid is a specimen, by a file of this process."""
    hu = head().values.transpose(2, 1, 0).astype(np.float32)
    scenario = load_scenario(DEMO, {"specimen": Volume(hu, grid_of_ct())})
    (part,) = scenario.specimen.parts
    assert part.shape.kind == "volume" and not part.homogeneous
    built = build_specimen(scenario.specimen)
    wanted = build(file, keep="all", centre=True)
    assert built.digest == wanted.digest


def test_voxels_in_a_file_are_the_same_voxels(monkeypatch, tmp_path):
    from twinct.specimen import grey

    monkeypatch.setattr(grey, "SPILLED_BYTES", 1)
    amounts = np.random.default_rng(5).random((3, 4, 5, 1), np.float32)
    field = grey.GreyField((BUILT_IN["water"],), amounts, VolumeGrid((3, 4, 5), 1.0))
    before = field.amounts
    field.spill(tmp_path / "missing")
    assert field.amounts is before
    field.spill(tmp_path)
    assert isinstance(field.amounts.base, np.memmap) and not list(tmp_path.iterdir())
    assert np.array_equal(field.amounts, amounts) and not field.amounts.flags.writeable


def test_unknown_names_are_refused_before_voxels_are_read(file, tmp_path, monkeypatch):
    from twinct.core.errors import InputError
    from twinct.scan import SimulationBuilder, builder

    monkeypatch.setattr(builder, "build_specimen", lambda _: pytest.fail("read the voxels"))
    masks = tmp_path / "masks"
    masks.mkdir()
    write(masks / "skull.nii", Truth((head().values == 1000).astype(float), head().affine), "<u1")
    of_file = {"kind": "volume", "path": str(file)}
    told = "evaluation.regions.0.shape.part: no part or label is called 'liver'; there are .*"
    for shape, name in (
        ({"kind": "volume", "phantom": "head"}, "brain"),
        (of_file | {"labels": {"path": str(masks)}}, "skull"),
        (of_file | {"labels": {"path": str(labels(tmp_path))}}, "and label_1, label_2"),
    ):
        keys = {
            "specimen": {"parts": [{"name": "head", "shape": shape}], "reference": "skul"},
            "evaluation": {"regions": [{"name": "a", "shape": {"kind": "part", "part": "liver"}}]},
        }
        with pytest.raises(InputError, match=told + name) as caught:
            _ = SimulationBuilder(load_scenario(DEMO, keys)).specimen
        assert "specimen.reference: no part or label is called 'skul'" in str(caught.value)
