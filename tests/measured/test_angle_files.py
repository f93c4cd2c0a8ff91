"""Files of angles: lists, numbered views, decimal commas, and text as Windows writes it."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.measured.angle_files import read_angles
from twinct.measured.numbers import read_numbers

ANGLES = [0.0, 1.5, 3.25, 4.5]


@pytest.mark.parametrize(
    "text",
    [
        "0\n1.5\n3.25\n4.5\n",
        "0 1.5\n3.25 4.5\n",
        "0, 1.5, 3.25, 4.5",
        "angle\r\n0\r\n1.5\r\n3.25\r\n4.5\r\n",
        "# deg\n1 0\n2 1.5\n3 3.25\n4 4.5\n",
        "view;angle\n0;0\n1;1,5\n2;3,25\n3;4,5\n",
        "1\t0,0\n2\t1,5\n3\t3,25\n4\t4,5\n",
        "1, 0,0\n2, 1,5\n3, 3,25\n4, 4,5\n",
        "0,0\n1,5\n3,25\n4,5\n",
        "0\n1,5\n3,25\n4,5\n",
        "Winkel\n0,0\n1,5\n3,25\n4,5\n",
        "4 4.5\n3 3.25\n1 0\n2 1.5\n",
        "1.5 2\n0 1\n4.5 4\n3.25 3\n",
        "a_1.tif 0\na_2.tif 1,5\na_3.tif 3,25\na_4.tif 4,5\n",
        "file,angle\na_1.tif,0\na_2.tif,1.5\na_3.tif,3.25\na_4.tif,4.5\n",
        "Projs Frames Exp\n4 1 500\nProjection Angle(deg) Time(s)\n"
        "1\t0\t0.1\n2\t1.5\t0.7\n3\t3.25\t1.3\n4\t4.5\t2\n",
        "Proj\tAngle(deg)\n1:\t0\n2:\t1.5\n3:\t3.25\n4:\t4.5\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252"])
def test_angles_are_found_in_a_text(text, encoding, tmp_path):
    path = tmp_path / "angles.txt"
    path.write_bytes(text.encode(encoding))
    assert read_angles(path, "", 4, "angles").tolist() == ANGLES


def test_angles_beside_the_numbers_of_the_views(tmp_path):
    path = tmp_path / "angles.txt"
    path.write_text("".join(f"{i},{15 * i}\n" for i in range(24)))
    assert read_angles(path, "", 24, "angles").tolist() == [15.0 * i for i in range(24)]
    np.save(tmp_path / "a.npy", np.stack([np.arange(4), ANGLES], axis=1))
    assert read_angles(tmp_path / "a.npy", "", 4, "angles").tolist() == ANGLES


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,0\n1,1\n2,2\n3,3\n", "4 lines such as 3,3 are numbers with a decimal comma, or views"),
        ("5 0\n7 1\n9 2\n12 3.5\n", "4 lines of 2 numbers, and neither .* numbers the views"),
        ("0\n1.5\nfoo\n4.5\n7\n", "'foo' are not numbers"),
        ("0\n1.5\ninf\n4.5\n", "not finite"),
        ("0\n1.5 3\n", "not hold the same count"),
        ("", "no line holds numbers"),
    ],
)
def test_other_texts_are_named(text, message, tmp_path):
    path = tmp_path / "angles.txt"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_angles(path, "", 4, f"{path}: angles")


def test_bytes_that_are_no_text_are_named(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"\x81\x8d\x00\x01 7")
    with pytest.raises(InputError, match="neither UTF-8, UTF-16 nor Windows-1252"):
        read_angles(tmp_path / "a.txt", "", 4, "angles")


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("1,5;2;-3,25\n4;5;6,0\n", [[1.5, 2, -3.25], [4, 5, 6]]),
        ("1,5\t2\n4\t5,5\n", [[1.5, 2], [4, 5.5]]),
        ("x y\n1,5e1 2\n4 5\n", [[15, 2], [4, 5]]),
        ("1, 2, 3\n4, 5, 6\n", [[1, 2, 3], [4, 5, 6]]),
        ("1,2,3\n4,5,6\n", [[1, 2, 3], [4, 5, 6]]),
        ("1.5,2 3\n4,5 6\n", [[1.5, 2, 3], [4, 5, 6]]),
    ],
)
def test_commas_are_decimal_only_beside_other_separators(text, numbers, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(text)
    assert read_numbers(path, "", "table").tolist() == numbers


@pytest.mark.parametrize("ending", ["npy", "npz", "h5", "nxs", "zarr"])
def test_arrays_of_angles_are_read_by_their_name(ending, tmp_path):
    path, name = tmp_path / f"angles.{ending}", "exchange/theta"
    others = {name: np.array(ANGLES), "exchange/data": np.zeros((4, 2, 3))}
    if ending == "npy":
        np.save(path, ANGLES)
    elif ending == "npz":
        np.savez(path, **{key.replace("/", "_"): value for key, value in others.items()})
        name = "exchange_theta"
    elif ending == "zarr":
        zarr = pytest.importorskip("zarr")
        name, group = "theta", zarr.create_group(str(path))
        group.create_array("theta", data=np.array(ANGLES))
        group.create_array("data", data=np.zeros((4, 2, 3)))
    else:
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            for key, value in others.items():
                file[key] = value
    np.testing.assert_array_equal(read_angles(path, name, 4, "angles"), ANGLES)
    if ending != "npy":
        with pytest.raises(InputError, match="no array 'omega'; it holds "):
            read_angles(path, "omega", 4, "angles")


def test_arrays_that_fill_the_memory_are_refused(tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "large.h5", "w") as file:
        file.create_dataset("theta", shape=(2**30,), dtype="f8", chunks=(2**20,))
    with pytest.raises(InputError, match="holds 8589934592 bytes; at most 4294967296 are read"):
        read_angles(tmp_path / "large.h5", "theta", 4, "angles")
