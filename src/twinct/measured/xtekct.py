"""Files of Nikon machines (.xtekct): the section [XTekCT] with its numbers, and the images' names.

Readers of others agree on the names: images are ``Name InputSeparator 0001.tif`` in the folder
``InputFolderName`` beside the file (cil.io.NikonDataReader, CCPi's XtekReader).
"""

from __future__ import annotations

import configparser
import glob
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from twinct.core.errors import InputError
from twinct.core.foreign_text import number, quoted, shortened
from twinct.measured.windows_text import read_windows_text

_NEEDED = ("SrcToObject", "SrcToDetector", "DetectorPixelSizeX", "DetectorPixelSizeY")
_NEEDED += ("DetectorPixelsX", "DetectorPixelsY", "Projections", "AngularStep")
_NUMBERS = (
    *_NEEDED,
    *("InitialAngle", "ObjectOffsetX", "ObjectRoll", "ObjectTilt"),
    *("CentreOfRotationTop", "CentreOfRotationBottom", "WhiteLevel"),
)
_TEXTS = ("Name", "InputSeparator", "InputFolderName")
_WITHOUT_EFFECT = (
    "Voxel Offset MaskRadius Coef Scattering Region Units Scale Output Input Derivative Filter "
    "Cut MedianFilter Xray Intensity Blanking Order Interpolation Timing Auto CTPro Version "
    "Product Name Operator Import Median Automatic Convert Extended Increment Modifier Slice Angle "
    "Flux Use Dim Reference BlackLevel Hu Air Normalisation AngularStep Helical Modifier Exponent "
    "Scaling TIFFScaling LowPercentile HighPercentile Convolution BeamHardening Shuttling"
).split()
"""Beginnings of keys on the volume, the beam hardening and the software."""

_MATTER = ("DetectorOffsetX", "DetectorOffsetY", "DetectorAngle", "DetectorTilt", "HelicalPitch")
"""Keys with an effect on the geometry, whose signs no public reader agrees on."""

_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+([eE][+-]?[0-9]+)?")
"""Number as Windows writes it in countries with a decimal comma."""

MOST_NOTED = 12
"""Largest number of unknown keys that a note names."""


@dataclass(frozen=True)
class Xtekct:
    """Content of an .xtekct file that matters.

    Attributes:
        path: the file.
        numbers: numbers by their keys.
        texts: texts by their keys, as far as the file has them.
        notes: a sentence on the keys that are not used, if there are any.
    """

    path: Path
    numbers: Mapping[str, float]
    texts: Mapping[str, str]
    notes: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name of the scan."""
        return self.texts.get("Name", "") or self.path.stem

    def images(self) -> Path:
        """Return the pattern of the images: those of this name, else all TIFF files of a folder.

        Raises:
            InputError: no folder that the file may mean holds a TIFF file.
        """
        folders = [folder for folder in dict.fromkeys(self._folders()) if folder.is_dir()]
        separator = self.texts.get("InputSeparator")
        prefixes = [self.name + s for s in (("_", "") if separator is None else (separator,))]
        for prefix in (*prefixes, None):
            for folder in folders:
                if pattern := _pattern(folder, prefix):
                    return pattern
        raise InputError(
            f"{self.path}: no image {prefixes[0]}0001.tif, nor any other TIFF file, is in "
            f"{' or '.join(map(str, folders))} (Name is {quoted(self.name)}, InputSeparator "
            f"{quoted(separator or '')}, InputFolderName "
            f"{quoted(self.texts.get('InputFolderName', ''))})"
        )

    def _folders(self) -> Iterator[Path]:
        """Yield the folders that may be meant: as stated, by its last name, and the file's own."""
        here, stated = self.path.parent, self.texts.get("InputFolderName", "")
        if stated:
            windows = PureWindowsPath(stated)
            yield here / (stated if windows.drive else windows.as_posix())
            yield here / windows.name
        yield here


def _pattern(folder: Path, prefix: str | None) -> Path | None:
    """Return a pattern of the TIFF files in a folder whose names are a prefix and a number."""
    for file in sorted(folder.iterdir()):
        if file.suffix.lower() not in (".tif", ".tiff"):
            continue
        if prefix is None:
            return folder / f"*{file.suffix}"
        start, rest = file.stem[: len(prefix)], file.stem[len(prefix) :]
        if start.lower() == prefix.lower() and re.fullmatch("[0-9]+", rest):
            return folder / f"{glob.escape(start)}[0-9]*{file.suffix}"
    return None


def read_xtekct(path: Path, ignore: tuple[str, ...] = ()) -> Xtekct:
    """Read an .xtekct file in UTF-8, UTF-16 or Windows-1252; the case of names does not count.

    Args:
        path: the file.
        ignore: keys that are treated as absent.

    Raises:
        InputError: the file is none, or a key is missing, no number, or has an effect that is not
            known.
    """
    section = _section(path)
    for key in ignore:
        section.pop(key.lower(), None)
    texts = {key: section[key.lower()][1] for key in _TEXTS if key.lower() in section}
    stated = {lower: pair for lower, pair in section.items() if pair[1]}
    problems = [f"the key {key} is missing" for key in _NEEDED if key.lower() not in stated]
    numbers: dict[str, float] = {}
    for key in _NUMBERS:
        if key.lower() in stated:
            text = stated[key.lower()][1]
            try:
                numbers[key] = _number(text)
            except ValueError:
                problems.append(f"{key} is {quoted(text)}, not a finite number")
    problems += _wrong(numbers)
    for key in _MATTER:
        if key.lower() in stated and not _is_zero(text := stated[key.lower()][1]):
            problems.append(
                f"{key} is {quoted(text)}, and may matter, but is not read: state the geometry as "
                "kind: circle, or name the key in geometry.ignore"
            )
    if problems:
        raise InputError([f"{path}: {problem}" for problem in problems])
    return Xtekct(path, numbers, texts, _note_of_unknown(path, stated))


class _Parser(configparser.ConfigParser):
    """Parser that keeps the case of keys, for messages."""

    def optionxform(self, optionstr: str) -> str:
        """Return a key as it is."""
        return optionstr


def _section(path: Path) -> dict[str, tuple[str, str]]:
    """Return the keys and texts of the section [XTekCT] by the keys in small letters."""
    parser = _Parser(interpolation=None, strict=False, allow_no_value=True, delimiters=("=",))
    try:
        parser.read_string(read_windows_text(path, f"{path}", 2**20))
    except configparser.Error as error:
        raise InputError(f"{path}: not an .xtekct file: {str(error).splitlines()[0]}") from None
    for name in parser.sections():
        if name.strip().lower() == "xtekct":
            pairs = parser.items(name, raw=True)
            return {key.lower(): (key, (text or "").strip()) for key, text in pairs}
    raise InputError(f"{path}: not an .xtekct file: it has no section [XTekCT]")


def _wrong(numbers: Mapping[str, float]) -> Iterator[str]:
    """Yield a sentence for each number that no machine has."""
    for key in _NEEDED[:-1]:
        if key in numbers and numbers[key] <= 0:
            yield f"{key} is {numbers[key]:g}; it must be above 0"
    sod, sdd = (numbers.get(key, math.nan) for key in ("SrcToObject", "SrcToDetector"))
    if 0 < sdd <= sod:
        yield f"SrcToDetector ({sdd:g}) must exceed SrcToObject ({sod:g})"


def _note_of_unknown(path: Path, stated: Mapping[str, tuple[str, str]]) -> tuple[str, ...]:
    known = {key.lower() for key in (*_NUMBERS, *_TEXTS, *_MATTER)}
    beginnings = tuple(beginning.lower() for beginning in _WITHOUT_EFFECT)
    unknown = [
        f"{shortened(key, 40)} ({shortened(text, 40)})"
        for lower, (key, text) in stated.items()
        if lower not in known and not lower.startswith(beginnings) and not _is_zero(text)
    ]
    if not unknown:
        return ()
    more = f" and {len(unknown) - MOST_NOTED} more" if len(unknown) > MOST_NOTED else ""
    return (f"{path.name}: unknown keys, not used: {', '.join(unknown[:MOST_NOTED])}{more}",)


def _number(text: str) -> float:
    value = number(text.replace(",", ".") if _COMMA.fullmatch(text) else text)
    if not math.isfinite(value):
        raise ValueError
    return value


def _is_zero(text: str) -> bool:
    try:
        return _number(text) == 0
    except ValueError:
        return text.lower() == "false"
