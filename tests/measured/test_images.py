"""Images of measured scans: every format, corrections, and bad input that is named."""

from __future__ import annotations

import re
from unittest.mock import Mock

import numpy as np
import pytest
import tifffile
from ball_scan import COLUMNS, ROWS, VIEWS, ball_images, orbit
from soft_balls import circle_of, images

from twinct.core.errors import InputError, ScenarioError
from twinct.measured import import_measured, importing
from twinct.measured.bad_pixels import filled, unlike
from twinct.measured.description import Files
from twinct.measured.stack import open_stack
from twinct.scan import ScanStore

SHAPE = (VIEWS, ROWS, COLUMNS)
LINES = ball_images(orbit())
COUNTS = np.random.default_rng(0).integers(0, 60000, (3, 5, 7)).astype(np.uint16)


def as_dicom(folder):
    from pydicom.dataset import FileDataset, FileMetaDataset
    from pydicom.uid import ExplicitVRLittleEndian

    for index, image in enumerate(COUNTS):
        meta = FileMetaDataset()
        meta.TransferSyntaxUID = ExplicitVRLittleEndian
        meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.1"
        meta.MediaStorageSOPInstanceUID = f"1.2.3.{index}"
        told = FileDataset(None, {}, file_meta=meta, preamble=b"\0" * 128)
        told.Rows, told.Columns = image.shape
        told.SamplesPerPixel, told.PhotometricInterpretation = 1, "MONOCHROME2"
        told.BitsAllocated = told.BitsStored = 16
        told.HighBit, told.PixelRepresentation = 15, 0
        told.InstanceNumber = index + 1
        told.PixelData = image.tobytes()
        told.save_as(folder / f"{2 - index}.dcm", enforce_file_format=True)
    return {"path": folder}


def as_tiffs(folder):
    for index, image in enumerate(COUNTS):
        tifffile.imwrite(folder / f"view_{index + 8}.tif", image)  # 8, 9, 10: not by letters
    return {"path": folder / "view_*.tif"}


def as_raws(folder):
    for index, image in enumerate(COUNTS):
        (folder / f"{index}.raw").write_bytes(b"head" + image.astype(">u2").tobytes())
    return {"path": folder, "dtype": ">u2", "rows": 5, "columns": 7, "header_bytes": 4}


def as_zarr(folder):
    import zarr

    group = zarr.create_group(str(folder / "scan.zarr"))
    group.create_array("images", data=COUNTS)
    group.create_array("angles", data=np.arange(3))
    return {"path": folder / "scan.zarr", "array": "images"}


def as_metaimage(folder):
    head = "ObjectType = Image\nNDims = 3\nDimSize = 7 5 3\nElementType = MET_USHORT\n"
    head += "BinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = False\n"
    head += "Offset = 0 0 0\nElementSpacing = 1 1 1\nTransformMatrix = 1 0 0 0 1 0 0 0 1\n"
    head += "ElementDataFile = LOCAL\n"
    (folder / "a.mha").write_bytes(head.encode() + COUNTS.tobytes())
    return {"path": folder / "a.mha"}


def as_npz(folder):
    np.savez(folder / "a.npz", images=COUNTS, angles=np.zeros(3))
    return {"path": folder / "a.npz", "array": "images"}


def as_stack_of_tiff(folder):
    tifffile.imwrite(folder / "a.tif", COUNTS, photometric="minisblack")
    return {"path": folder / "a.tif"}


def as_npys(folder):
    for index, image in enumerate(COUNTS):
        np.save(folder / f"{index}.npy", image)
    return {"path": folder}


def as_hdf5(folder):
    h5py = pytest.importorskip("h5py")
    with h5py.File(folder / "a.h5", "w") as file:
        file["exchange/data"] = COUNTS
        file["exchange/theta"] = np.zeros(3)
    return {"path": folder / "a.h5", "array": "exchange/data"}


FORMATS = [as_dicom, as_tiffs, as_raws, as_zarr, as_metaimage, as_npz, as_stack_of_tiff, as_npys]


@pytest.mark.parametrize("save", [*FORMATS, as_hdf5])
def test_every_format_gives_the_stored_numbers(save, tmp_path):
    keys = save(tmp_path)
    stack = open_stack(Files(**keys | {"path": str(keys["path"])}), "images")
    assert (stack.count, stack.shape) == (3, (5, 7))
    for index, image in enumerate(COUNTS):
        np.testing.assert_array_equal(stack.image(index), image)


def test_intensities_become_transmissions(circle, stored, imported, tmp_path):
    """Two flats with a drift between them, a dark image, and a beam that flickers."""
    rng = np.random.default_rng(1)
    truth = np.exp(-ball_images(orbit()))
    dark = rng.uniform(90, 110, (ROWS, COLUMNS))
    gain = rng.uniform(0.8, 1.2, (ROWS, COLUMNS))
    share = np.arange(VIEWS) / (VIEWS - 1)
    flicker = rng.uniform(0.9, 1.1, VIEWS)
    flats = [np.stack([30000 * gain + dark] * 2), 40000 * (gain**2) + dark]
    bright = (1 - share)[:, None, None] * 30000 * gain + share[:, None, None] * 40000 * gain**2
    for name, array in (("dark", dark), ("flat0", flats[0]), ("flat1", flats[1])):
        np.save(tmp_path / f"{name}.npy", array)
    section = stored(
        dark + flicker[:, None, None] * bright * truth,
        "intensities",
        flats=[
            {"path": str(tmp_path / "flat0.npy"), "view": 0},
            {"path": str(tmp_path / "flat1.npy"), "view": VIEWS - 1},
        ],
        darks=[{"path": str(tmp_path / "dark.npy")}],
        air={"rows": [ROWS - 3, ROWS], "columns": [0, COLUMNS]},
    )
    scan, told = imported({"images": section, "geometry": circle})
    np.testing.assert_allclose(scan.transmission, truth, rtol=2e-6)
    assert f"air: {flicker.min():.4g} to {flicker.max():.4g}" in "\n".join(told.notes)


@pytest.mark.parametrize("turned", [False, True])
def test_gains_of_pixels_are_told_by_the_mean_view(turned, circle, stored, imported):
    """Against the same images without gains; whole columns off are rings, too."""
    rng = np.random.default_rng(4)
    truth = np.exp(-images(circle_of()))
    shape = truth.shape[1:]
    gain = np.exp(0.03 * rng.normal(size=shape) * (rng.random(shape) < 0.2))
    gain[:, 8] *= 0.95
    image, turn = gain * truth, {}
    if turned:  # by 270 deg: the columns of the stored images are the rows of the turned ones
        image, turn = np.rot90(image, axes=(1, 2)), {"turn_deg": 270}
    section = stored(image, "transmissions", rings={"width": 5}, **turn)
    geometry = circle | {"angles": {"step": 360 / len(truth)}, "pitch_mm": 2.4}
    scan, told = imported({"images": section, "geometry": geometry})
    left = np.log(scan.transmission / truth)
    assert np.sqrt(np.mean(left**2)) < 0.45 * np.sqrt(np.mean(np.log(gain) ** 2))
    assert np.abs(left[:, :, 8].mean()) < 0.003
    assert "rings: gains of pixels corrected by 1.3 % (RMS)" in "\n".join(told.notes)


def test_an_even_median_is_refused(circle, stored, imported):
    section = stored(np.exp(-ball_images(orbit())), "transmissions", rings={"width": 4})
    with pytest.raises(InputError, match="images.rings.*width: 4 must be odd"):
        imported({"images": section, "geometry": circle})


def test_bad_pixels_are_found_filled_and_left_out(circle, stored, imported, tmp_path):
    images = np.exp(-ball_images(orbit()))
    bad = np.zeros((ROWS, COLUMNS), bool)
    bad[4, 5] = bad[10, 11:13] = bad[15, 20] = True
    raw = np.where(bad, 0.0, 1000 * images)
    raw[:, 15, 20] = np.nan
    flat = np.where(bad, 0.0, 1000.0)
    flat[10, 11:13] = 2600.0  # bright, not dead
    np.save(tmp_path / "flat.npy", flat)
    named = np.zeros((ROWS, COLUMNS), np.uint8)
    named[15, 20] = 1
    np.save(tmp_path / "map.npy", named)
    flats = [{"path": str(tmp_path / "flat.npy")}]
    pixels = {"find": True, "path": str(tmp_path / "map.npy")}
    section = stored(raw, "intensities", flats=flats, bad_pixels=pixels)
    scan, told = imported({"images": section, "geometry": circle})
    np.testing.assert_array_equal(scan.bad_pixels, bad)
    assert np.abs(scan.transmission - images).max() < 0.12
    assert "bad pixels: 4 of 520, filled" in told.notes


def test_filling_and_finding_of_pixels():
    image = np.add.outer(np.arange(9.0), np.arange(9.0)) + 100
    bad = np.zeros(image.shape, bool)
    bad[3:6, 3:6] = True
    assert np.abs(filled(np.where(bad, np.nan, image), bad) - image).max() < 1.01
    hot = image.copy()
    hot[2, 7] = 180
    np.testing.assert_array_equal(unlike(hot, np.zeros_like(bad)), hot != image)


LIT = np.full((ROWS, COLUMNS), 50000, np.uint16)
FULL = np.full((ROWS, COLUMNS), 65535, np.uint16)
RAW = np.full(SHAPE, 30000, np.uint16)


@pytest.mark.parametrize(
    ("flat", "message"),
    [
        (None, "intensities need flats"),
        (FULL, r"flats.0.*image 0 is saturated: 100.0% of its pixels are 65535"),
        (np.where(np.arange(ROWS)[:, None] < 2, 4095, LIT // 16), "4095, the largest number of 12"),
        (np.zeros_like(LIT), "100.0% of the pixels are no brighter than 0"),
        (LIT[:5], "5 x 26 pixels, but the projections have 20 x 26"),
        (np.full_like(LIT, 100), "does images.flats belong to these images"),
    ],
)
def test_bad_flats_are_named(flat, message, circle, stored, imported, tmp_path):
    keys = {}
    if flat is not None:
        np.save(tmp_path / "flat.npy", flat)
        keys = {"flats": [{"path": str(tmp_path / "flat.npy")}]}
    with pytest.raises(InputError, match=message):
        imported({"images": stored(RAW, "intensities", **keys), "geometry": circle})
    assert not list(tmp_path.glob("imported*/scan.zarr"))


@pytest.mark.parametrize(
    ("array", "values", "message"),
    [
        (RAW, "line_integrals", "are they intensities"),
        (RAW, "transmissions", "are they intensities"),
        (LINES, "transmissions", "of the pixels are 0 or below.*are they line integrals"),
        (-np.exp(-LINES), "transmissions", "100% of the pixels are 0 or below"),
        (np.full(SHAPE, np.nan), "transmissions", "image 0: 520 pixels are not finite"),
        (np.ones(SHAPE)[:7], "transmissions", "not full"),
        (np.ones(SHAPE)[0, 0], "transmissions", r"shape \(26,\); expected 3 axes"),
        (np.ones(SHAPE).astype(complex), "transmissions", "holds complex128, not numbers"),
    ],
)
def test_bad_images_are_named(array, values, message, circle, stored, imported):
    if message == "not full":
        message = "24 angles, but there are 7 images"
        circle |= {"angles": {"values": list(range(0, 360, 15))}}
    with pytest.raises(InputError, match=message):
        imported({"images": stored(array, values), "geometry": circle})


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"white": 900.0}, "divided by images.white, numbers reach 33"),
        ({"white": 4e6}, "does images.white belong to these images"),
        ({"white": 4e4, "every": 24}, "images.every: 24 leaves one of 24 views"),
        ({"flats": [{"path": "LIT", "view": 200}]}, "flats.0.view: 200 is none of the views 0 to"),
    ],
)
def test_intensities_fit_their_white_and_their_views(
    keys, message, circle, stored, imported, tmp_path
):
    np.save(tmp_path / "LIT.npy", LIT)
    for flat in keys.get("flats", ()):
        flat["path"] = str(tmp_path / "LIT.npy")
    with pytest.raises(InputError, match=message):
        imported({"images": stored(RAW, "intensities", **keys), "geometry": circle})


@pytest.mark.parametrize(
    ("images", "angles", "grid", "message"),
    [
        ({}, 15.0, "pitch", "the panel measures 5.2e\\+04 x 4e\\+04 mm at 300 mm from the source"),
        ({}, 0.0, None, "all 24 views have the same pose"),
        ({"rings": {"width": 5}}, 2.0, None, "images.rings: the views must cover a turn.* 0.9"),
        ({}, 15.0, {"voxels": 8, "voxel_mm": 1, "centre_mm": [0, 0, 5e3]}, "no view sees its vox"),
    ],
)
def test_views_that_show_nothing_are_named(images, angles, grid, message, circle, stored, imported):
    told = {"images": stored(LINES, **images), "geometry": circle | {"angles": {"step": angles}}}
    if grid == "pitch":
        told["geometry"]["pitch_mm"] = 2000.0
    elif grid:
        told["grid"] = grid
    with pytest.raises(InputError, match=message):
        imported(told)


@pytest.mark.parametrize(
    ("array", "angles", "doubt"),
    [
        (LINES, {"step": 15}, None),
        (LINES.transpose(1, 0, 2), {"step": 15}, "view to view, .* from row to row: are views and"),
        (LINES.transpose(2, 1, 0), {"step": 15}, "to column: .* See images.axes; --try tries both"),
        (np.exp(-LINES), {"step": 15}, "near 1 and hardly any near 0: are they transmissions"),
        (LINES[:1], {"step": 15}, "one view: no volume can be made from it"),
        (LINES, {"step": 0.15}, "24 views cover 3.45 deg: are the angles in radians"),
        (LINES, {"step": 1, "unit": "rad"}, "cover 3.66 turns: are they in degrees"),
    ],
)
def test_statements_that_are_seldom_right_are_doubted(
    array, angles, doubt, circle, stored, imported
):
    found = imported({"images": stored(array), "geometry": circle | {"angles": angles}})[1].doubts
    assert len(found) == (doubt is not None)
    assert all(re.search(str(doubt), sentence) for sentence in found)


def test_bad_stacks_are_named(tmp_path):
    def refused(message, **keys):
        with pytest.raises(InputError, match=message):
            open_stack(Files(**{"path": str(tmp_path)} | keys), "images")

    refused("images.path: .* does not exist", path=str(tmp_path / "none.tif"))
    refused("no file is there", path=str(tmp_path / "*.tif"))
    tifffile.imwrite(tmp_path / "1.tif", LIT)
    tifffile.imwrite(tmp_path / "2.tif", LIT[:7])
    refused("2.tif: images of 7 x 26 of uint16, but .*1.tif has 20 x 26 of uint16: image 1 must")
    with tifffile.TiffWriter(tmp_path / "all.tiff") as file:
        for image in (LIT, LIT, LIT[:7], LIT):
            file.write(image, contiguous=False)
    several = str(tmp_path / "all.tiff")
    refused(r"all.tiff: .* image 2 has shape \(7, 26\) of uint16, image 0 \(20, 26\)", path=several)
    (tmp_path / "all.tiff").unlink()
    (tmp_path / "2.raw").write_bytes(b"12345")
    refused("files of several kinds")
    raw = str(tmp_path / "2.raw")
    refused("need dtype .*, rows and columns", path=raw)
    refused("5 bytes .* not a whole number", path=raw, dtype="<u2", rows=2, columns=2)
    np.savez(tmp_path / "a.npz", one=LIT, two=LIT)
    refused("array: name one; it holds one, two", path=str(tmp_path / "a.npz"))
    refused("no array 'three'", path=str(tmp_path / "a.npz"), array="three")
    (tmp_path / "3.xyz").write_bytes(b"1")
    refused("ending '.xyz' are not read", path=str(tmp_path / "3.xyz"))


def test_files_of_zeiss_are_named_with_a_way_out(circle, imported, tmp_path, capsys):
    from twinct.cli import run_command

    path = tmp_path / "scan.txrm"
    path.write_bytes(b"\xd0\xcf\x11\xe0")
    message = "scan.txrm: files of Zeiss are not read: convert the projections to TIFF"
    assert run_command(["import", str(path), "--out", str(tmp_path / "out")]) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    images = {"path": str(path), "values": "intensities", "white": 1.0}
    for source in (path, {"images": images, "geometry": circle}):
        with pytest.raises(InputError, match=message):
            import_measured(source, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_bad_descriptions_are_named_with_their_line(imported, tmp_path):
    file = tmp_path / "scan.yaml"
    file.write_text("images: {path: a.npy, values: counts}\ngeometry: {kind: circle}\n")
    with pytest.raises(ScenarioError, match=r"scan.yaml:1: images.values") as caught:
        imported(file)
    assert "geometry.sod_mm" in str(caught.value)
    (tmp_path / "folder").mkdir()
    tifffile.imwrite(tmp_path / "folder" / "1.tif", LIT)
    with pytest.raises(InputError, match="images without geometry: it has no export.json"):
        imported(tmp_path / "folder")


def test_an_import_never_overwrites(circle, stored, tmp_path):
    from twinct.core.errors import ScanExistsError
    from twinct.measured import import_measured

    source = {"images": stored(ball_images(orbit())), "geometry": circle}
    import_measured(source, tmp_path / "out")
    with pytest.raises(ScanExistsError):
        import_measured(source, tmp_path / "out")


@pytest.mark.parametrize("own_folder", [False, True])
def test_an_import_cut_short_leaves_nothing(stored, circle, tmp_path, monkeypatch, own_folder):
    def stop(*_args, **_keys) -> None:
        raise KeyboardInterrupt

    source = {"name": "ball", "images": stored(ball_images(orbit())), "geometry": circle}
    out = tmp_path / "out"
    if own_folder:
        out.mkdir()
    with monkeypatch.context() as patch:
        patch.setattr(ScanStore, "write", stop)
        with pytest.raises(KeyboardInterrupt):
            import_measured(source, out)
    assert out.exists() == own_folder
    assert not own_folder or not list(out.iterdir())
    assert import_measured(source, out).folder == out


def test_an_import_that_is_interrupted_while_it_draws_can_be_repeated(
    circle, stored, monkeypatch, tmp_path
):
    told = {"images": stored(ball_images(orbit())), "geometry": circle}
    with monkeypatch.context() as patch:
        patch.setattr(importing, "show", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            import_measured(told, tmp_path / "out")
    assert not (tmp_path / "out").exists()
    import_measured(told, tmp_path / "out")
    assert (tmp_path / "out" / "imported.png").exists()
