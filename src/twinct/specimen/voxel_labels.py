"""Named labels and masks of a CT volume, from NIfTI files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import SpecimenError
from twinct.core.files.plain_xml import xml_of
from twinct.core.foreign_text import quoted, whole_number
from twinct.specimen import sections
from twinct.specimen.ct_grid import canonical, same_place
from twinct.specimen.ct_image import CtImage
from twinct.specimen.ct_nifti import read_ct_nifti

SUFFIX = re.compile(r"\.nii(\.gz)?$", re.IGNORECASE)

MOST_LABELS = 65535


def read_labels(
    section: sections.Labels, image: CtImage, where: str
) -> tuple[tuple[str, ...], NDArray[np.uint16]]:
    """Read the labels of a CT volume.

    Args:
        section: file, or folder of masks, and names.
        image: CT volume in canonical order.
        where: beginning of messages.

    Returns:
        Names, and the label of each voxel in the order of the image: i + 1 for name i, 0 for none.

    Raises:
        SpecimenError: files are damaged or on another grid, or a label does not exist.
    """
    where = f"{where}: labels {section.path}"
    if section.path.is_dir():
        return _of_folder(section, image, where)
    labels = _numbers(section.path, image, where)
    there = [int(n) for n in np.flatnonzero(np.bincount(labels.ravel())) if n]
    names = dict(section.names)
    if not names:
        stated = header_names(section.path)
        names = {stated.get(n, f"label_{n}"): n for n in there}
    if lost := [f"{quoted(name)} ({n})" for name, n in names.items() if n not in there]:
        raise SpecimenError(f"{where} has no voxel of {', '.join(lost)}; its labels are {there}")
    if not names:
        raise SpecimenError(f"{where} holds no label: all of its values are 0")
    renumbered = np.zeros(int(labels.max()) + 1, dtype=np.uint16)
    for i, number in enumerate(names.values()):
        renumbered[number] = i + 1
    return tuple(names), renumbered[labels]


def read_mask(path: Path, image: CtImage, where: str) -> NDArray[np.bool_]:
    """Read the voxels of a CT volume that count, in the order of the image.

    Raises:
        SpecimenError: the file is damaged, empty or on another grid.
    """
    where = f"{where}: mask {path}"
    mask = _on_grid(path, image, where).values > 0
    if not mask.any():
        raise SpecimenError(f"{where} is empty: none of its values is above 0")
    return mask


def mask_files(folder: Path) -> dict[str, Path]:
    """Return the NIfTI files of a folder by their names without suffix, sorted."""
    files = {SUFFIX.sub("", p.name): p for p in sorted(folder.iterdir())}
    return {name: p for name, p in files.items() if SUFFIX.search(p.name)}


def _of_folder(
    section: sections.Labels, image: CtImage, where: str
) -> tuple[tuple[str, ...], NDArray[np.uint16]]:
    """Read one mask for each name; where masks overlap, the later name wins."""
    files = mask_files(section.path)
    if section.names:
        raise SpecimenError(f"{where} is a folder, whose files state the names; leave names out")
    if not files:
        raise SpecimenError(f"{where} holds no NIfTI file")
    values, names = np.zeros(image.values.shape, dtype=np.uint16), []
    for name, file in files.items():
        mask = _on_grid(file, image, f"{where}: {file.name}").values > 0
        if mask.any():  # TotalSegmentator also writes what it did not find
            names.append(name)
            values[mask] = len(names)
    if not names:
        raise SpecimenError(f"{where} holds no label: all masks are empty")
    return tuple(names), values


def _numbers(path: Path, image: CtImage, where: str) -> NDArray[np.uint16]:
    values = _on_grid(path, image, where).values
    low, high = float(values.min()), float(values.max())
    if low < 0 or high > MOST_LABELS or not (values == np.round(values)).all():
        raise SpecimenError(
            f"{where}: its values lie between {low:g} and {high:g}; labels are whole numbers from "
            f"0 to {MOST_LABELS}"
        )
    return values.astype(np.uint16)


def _on_grid(path: Path, image: CtImage, where: str) -> CtImage:
    image_read = canonical(read_ct_nifti(path, where, sections.HuLine()))
    if not same_place(image_read, image):
        raise SpecimenError(
            f"{where} is on another grid than the CT: {_in_words(image_read)}, the CT "
            f"{_in_words(image)}; resample it to the CT's"
        )
    return image_read


def _in_words(image: CtImage) -> str:
    size, edges = (
        " x ".join(f"{n:.4g}" for n in row) for row in (image.values.shape, image.voxel_mm)
    )
    first = ", ".join(f"{x:.4g}" for x in image.affine[:3, 3])
    return f"{size} voxels of {edges} mm from ({first})"


def header_names(path: Path) -> dict[int, str]:
    """Return the names in the header's extension, as TotalSegmentator and Connectome write them."""
    import nibabel

    names: dict[int, str] = {}
    for extension in getattr(nibabel.load(path).header, "extensions", ()):
        content = extension.get_content()
        text = content if isinstance(content, bytes) else str(content).encode()
        try:
            root = xml_of(text.strip(b"\0 \n"))
        except ValueError:
            continue
        for label in root.iter("Label"):
            key = whole_number(label.get("Key", ""))
            if key is not None and label.text:
                names[key] = label.text.strip()
    return names
