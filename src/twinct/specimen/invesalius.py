"""CT volumes from InVesalius projects."""

from __future__ import annotations

import plistlib
import tarfile
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from twinct.core.errors import SpecimenError
from twinct.core.files.boundary import file_bytes, require_memory
from twinct.core.files.packed import open_packed, read_to_end, require_unpacked, unpacked_limit
from twinct.specimen import sections
from twinct.specimen.ct_image import STATE_HU, CtImage, in_hu, require_low_values


def read_invesalius(path: Path, where: str, line: sections.HuLine | None = None) -> CtImage:
    """Read an InVesalius project: a tar of main.plist and the raw volume (slice, row, column).

    The tar may be gzipped. Slices run upwards, rows to the front (VTK's origin is at the lower
    left), columns to the patient's left as in DICOM.

    Raises:
        SpecimenError: the project is incomplete or damaged, or its values are no HU.
    """
    main, raw = _contents(path, where)
    modality = main.get("modality", "CT")
    if modality != "CT" and line is None:
        raise SpecimenError(f"{where}: its modality is {modality}; expected CT; {STATE_HU}")
    try:
        shape = tuple(int(n) for n in main["matrix"]["shape"])
        spacing = np.array(main["spacing"], dtype=np.float64)
        dtype = np.dtype(main["matrix"]["dtype"])
    except KeyError as error:
        raise _incomplete(error, where) from None
    except (TypeError, ValueError):
        raise SpecimenError(
            f"{where}: its shape, spacing or dtype is no list of numbers or type"
        ) from None
    if len(shape) != 3 or min(shape) < 1 or spacing.shape != (3,) or dtype.kind not in "iuf":
        raise SpecimenError(
            f"{where}: shape {shape} of {dtype} and spacing {spacing.tolist()} do not describe a "
            "volume"
        )
    if not (np.isfinite(spacing).all() and spacing.min() > 0):
        raise SpecimenError(f"{where}: its spacing is {spacing.tolist()}; expected edges above 0")
    size = shape[0] * shape[1] * shape[2] * dtype.itemsize
    if size != len(raw):
        raise SpecimenError(
            f"{where}: shape {shape} of {dtype} needs {size} bytes, but its volume has {len(raw)}"
        )
    if line is None:
        require_low_values(dtype.kind, 1.0, 0.0, where)
    require_memory(where, 8 * len(raw) / dtype.itemsize, SpecimenError)
    values = np.frombuffer(raw, dtype=dtype).reshape(shape).transpose(2, 1, 0).astype(np.float32)
    return CtImage(in_hu(values, line), np.diag([-spacing[0], spacing[1], spacing[2], 1.0]))


def _contents(path: Path, where: str) -> tuple[dict[str, Any], bytes]:
    """Return the main property list and the bytes of the volume of an archive without damage."""
    size = file_bytes(path, where, kind=SpecimenError)
    try:
        with open_packed(path, where, SpecimenError) as (stream, packed):
            if packed:
                whole = read_to_end(stream, unpacked_limit(size))
                require_unpacked(size, whole, where, SpecimenError)
                stream.seek(0)
            with tarfile.open(fileobj=stream, mode="r:") as archive:
                files = _members(archive, size, where)
                main = _main(_extract(archive, files, "main.plist", where), where)
                name = PurePosixPath(str(main["matrix"]["filename"])).name
                return main, _extract(archive, files, name, where)
    except KeyError as error:
        raise _incomplete(error, where) from None
    except tarfile.TarError:  # its text lists every compression that was tried
        raise SpecimenError(
            f"{where} is not an InVesalius project: expected a tar archive, plain or gzipped"
        ) from None


def _main(text: bytes, where: str) -> dict[str, Any]:
    try:
        main = plistlib.loads(text)
    except Exception:  # of the parsers of XML and of binary lists, or of any value
        main = None
    if not isinstance(main, dict) or not isinstance(main.get("matrix", {}), dict):
        raise SpecimenError(f"{where}: its main.plist is damaged: it holds no property list")
    return main


def _members(archive: tarfile.TarFile, size: int, where: str) -> dict[str, tarfile.TarInfo]:
    """Return regular files of an archive by name, without links and devices, up to a total size."""
    members: dict[str, tarfile.TarInfo] = {}
    whole = 0
    for member in archive:
        whole += 512 + member.size  # also what a sparse file leaves out
        require_unpacked(size, whole, where, SpecimenError)
        if member.isfile():
            members[PurePosixPath(member.name).name] = member
    return members


def _extract(
    archive: tarfile.TarFile, files: dict[str, tarfile.TarInfo], name: str, where: str
) -> bytes:
    require_memory(where, 5 * files[name].size, SpecimenError)
    stream = archive.extractfile(files[name])
    if stream is None:
        raise KeyError(name)
    with stream:
        return stream.read()


def _incomplete(error: KeyError, where: str) -> SpecimenError:
    return SpecimenError(
        f"{where} is not a complete InVesalius project: {error.args[0]} is missing"
    )
