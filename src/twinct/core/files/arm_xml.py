"""Descriptions of arms, MJCF and URDF, with their includes and the files that they name.

The checked text is the text that MuJoCo loads: includes are expanded, and paths are absolute.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from twinct.core.errors import ScenarioError
from twinct.core.files.arm_sizes import require_picture, require_small
from twinct.core.files.boundary import ABSENT, PARSED_FACTOR, no_file, read_bytes, require_memory
from twinct.core.files.plain_xml import xml_of
from twinct.core.files.reading import reason
from twinct.core.files.ros_packages import PATHS, is_package, package_folder, package_of
from twinct.core.foreign_text import number, quoted, shortened

LARGEST_BYTES = 16 * 2**20
"""Largest XML file; the largest arms of Menagerie have 0.03 MB."""

MESHES = (".stl", ".obj", ".msh")
"""Mesh formats that MuJoCo reads."""

_OF_A_SCENE = ("option", "size", "visual", "statistic", "keyframe", "sensor")
_PACKAGE = "package://"


@dataclass(frozen=True, eq=False)
class ArmXml:
    """One arm in the form that MuJoCo's parser takes.

    Attributes:
        text: MJCF or URDF without includes, with absolute paths.
        files: all files that were read or are named, the arm's own first.
        is_urdf: True for URDF, False for MJCF.
        speed_limits: rad/s by joint, for joints with a limit above zero; MJCF has none.
    """

    text: str
    files: tuple[Path, ...]
    is_urdf: bool
    speed_limits: dict[str, float]


def read_arm_xml(path: Path, where: str) -> ArmXml:
    """Read a description and locate the files that it names.

    Args:
        path: MJCF (``mujoco``, includes allowed) or URDF (``robot``).
        where: name of the description in messages.

    Raises:
        ScenarioError: the file is missing, not XML, or neither MJCF nor URDF, or a file that it
            names is missing or lies outside its folder.
    """
    try:
        path = path.resolve()
        root, files = _parsed(path, where), [path]
        if any("xacro" in element.tag for element in root.iter()):
            raise ScenarioError(
                f"{where} contains macros: twinct arm {path.name} --out FOLDER writes it without "
                "them, with all meshes"
            )
        if root.tag not in ("mujoco", "robot"):
            raise ScenarioError(
                f"{where} is neither MJCF, which begins with <mujoco>, nor URDF, which begins with "
                f"<robot>: it begins with <{root.tag}>"
            )
        is_urdf = root.tag == "robot"
        files += _urdf_meshes(root, path, where) if is_urdf else _include(root, path, where)
        files += [] if is_urdf else _mjcf_assets(root, path, where)
        speeds = dict(_speeds(root, where)) if is_urdf else {}
        text = ElementTree.tostring(root, encoding="unicode")
    except RecursionError:
        raise ScenarioError(f"{where} is nested too deep") from None
    except (OSError, RuntimeError) as error:  # names too long, or circular links
        raise ScenarioError(f"{where} cannot be read: {reason(error)}") from None
    return ArmXml(text, tuple(dict.fromkeys(files)), is_urdf, speeds)


def _parsed(path: Path, where: str) -> Any:
    data = read_bytes(path, where, LARGEST_BYTES, ScenarioError)
    require_memory(where, PARSED_FACTOR * len(data), ScenarioError)
    try:
        return xml_of(data)
    except ValueError as error:
        raise ScenarioError(f"{where} is not readable XML: {shortened(str(error))}") from None


def _inside(main: Path, name: str, where: str, folder: Path | None = None) -> Path:
    """Return the file that ``name`` refers to, relative to the folder of the arm's own file.

    Args:
        main: the arm's own file.
        name: name of the other file.
        where: name of the description in messages.
        folder: folder that the file must lie in; None stands for that of the arm's own file.
    """
    folder = folder or main.parent
    file = (main.parent / name).resolve()
    if not file.is_relative_to(folder):
        raise ScenarioError(
            f"{where} names {quoted(name)}, outside its folder {folder}: copy the file into it"
        )
    if why := no_file(file):
        problem = f"there is no file {file}" if why == ABSENT else f"{file} {why}"
        raise ScenarioError(f"{where} names {quoted(name)}, but {problem}")
    return file


def _include(root: Any, main: Path, where: str) -> list[Path]:
    """Replace the includes of MJCF by their content; names refer to the arm's own folder first."""
    files, pending = [], [root]
    while pending:
        parent, k = pending.pop(), 0
        while k < len(parent):
            if parent[k].tag != "include":
                k += 1
                continue
            file = _inside(main, parent[k].get("file", ""), where)
            if file in (main, *files):
                raise ScenarioError(f"{where} includes {file.name} twice")
            files.append(file)
            included = _parsed(file, f"{where}: its include {file.name}")
            for inner in included.iter("include"):
                beside = file.parent / inner.get("file", "")
                if beside.is_file() and not (main.parent / inner.get("file", "")).is_file():
                    inner.set("file", str(beside))
            parent[k : k + 1] = list(included)
        pending += parent
    return files


def _mjcf_assets(root: Any, main: Path, where: str) -> list[Path]:
    for element in [e for e in root if e.tag in _OF_A_SCENE]:
        root.remove(element)
    settings: dict[str, str] = {}
    for compiler in root.iter("compiler"):
        for name in ("assetdir", "meshdir", "texturedir", "strippath"):
            if (value := compiler.attrib.pop(name, None)) is not None:
                settings |= {name: value}
                settings |= {"meshdir": value, "texturedir": value} if name == "assetdir" else {}
    files = []
    require_small(root, where)
    for element in root.iter():
        if element.tag == "model" and element.get("file"):
            raise ScenarioError(
                f"{where} attaches another model, {quoted(element.get('file'))}: include it instead"
            )
        folder = settings.get("texturedir" if element.tag == "texture" else "meshdir", "")
        for name in [name for name in element.attrib if name.startswith("file")]:
            file = element.get(name)
            file = Path(file).name if settings.get("strippath") == "true" else file
            files.append(_inside(main, str(Path(folder) / file), where))
            if files[-1].suffix.lower() == ".png":
                require_picture(files[-1], where)
            if element.tag in ("mesh", "texture", "hfield") and element.get("name") is None:
                element.set("name", Path(file).stem)
            element.set(name, str(files[-1]))
    return files


def _urdf_meshes(root: Any, main: Path, where: str) -> list[Path]:
    for parent in list(root.iter()):
        for visual in parent.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and Path(mesh.get("filename", "")).suffix.lower() not in MESHES:
                parent.remove(visual)  # such as Collada; only the picture loses it
        for texture in parent.findall("texture"):
            parent.remove(texture)
        for shape in (*parent.findall("visual"), *parent.findall("collision")):
            shape.attrib.pop("name", None)  # MuJoCo warns of names that occur twice
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.SubElement(root, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(extension, "compiler")
    folder = compiler.attrib.pop("meshdir", "")
    # The flange may be a link that does not move. Shapes that are only visible make the picture.
    compiler.attrib |= {"fusestatic": "false", "discardvisual": "false", "strippath": "false"}
    files = []
    for mesh in root.iter("mesh"):
        name: str = mesh.get("filename", "")
        if Path(name).suffix.lower() not in MESHES:
            raise ScenarioError(
                f"{where} names the collision mesh {quoted(name)}; only {', '.join(MESHES)} "
                "can be read"
            )
        files.append(mesh_file(name, folder, main, where))
        mesh.set("filename", str(files[-1]))
    return files


def mesh_file(name: str, folder: str, main: Path, where: str) -> Path:
    """Return the file that a mesh of a URDF refers to.

    Args:
        name: ``package://NAME/PATH``, ``file://PATH``, or a path.
        folder: MuJoCo's ``meshdir``, for plain paths.
        main: the URDF.
        where: name of the URDF in messages.

    Raises:
        ScenarioError: there is no such package or file, or the file is outside of the package.
    """
    if not name.startswith(_PACKAGE):
        path = str(Path(folder) / name.removeprefix("file://"))
        return _inside(main, path, where, package_of(main))
    with_package = name.removeprefix(_PACKAGE)
    package, _, rest = with_package.partition("/")
    for file in (with_package, rest):
        if (main.parent / file).is_file():
            return _inside(main, file, where)
    if (of_package := package_folder(package, main)) is None:
        raise ScenarioError(
            f"{where} names {quoted(name)}, but the package {quoted(package)} was not found: it "
            f"was searched in {main.parent} and the folders above, and in {' and '.join(PATHS)}. "
            f"Set {PATHS[0]} to the folder that contains the package, or copy the meshes to "
            f"{main.parent / rest}"
        )
    # An installed package may consist of links to its sources.
    inside = package_of((of_package / rest).resolve())
    linked = inside is not None and is_package(inside, package)
    return _inside(main, str(of_package / rest), where, inside if linked else of_package.resolve())


def _speeds(root: Any, where: str) -> Iterator[tuple[str, float]]:
    for joint in root.findall("joint"):
        limit = joint.find("limit")
        text = "0" if limit is None else limit.get("velocity", "0")
        try:
            speed = number(text)
        except ValueError:
            speed = math.nan
        if not 0 <= speed < math.inf:
            raise ScenarioError(
                f"{where}: joint {joint.get('name')}: velocity {quoted(text)} is not a speed "
                "in rad/s"
            )
        if speed > 0:  # exporters write 0 for an unknown limit
            yield joint.get("name", ""), speed
