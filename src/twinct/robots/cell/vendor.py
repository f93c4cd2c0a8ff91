"""Descriptions of arms as vendors ship them, written into a folder of their own.

Macros are expanded by xacro's own library. As it evaluates expressions of Python, nothing but the
command ``twinct arm`` calls it: a scenario never names a file with macros.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from twinct.core.errors import ScenarioError
from twinct.core.extras import require
from twinct.core.files.arm_xml import LARGEST_BYTES, mesh_file
from twinct.core.files.boundary import read_bytes
from twinct.core.files.ros_packages import PATHS, package_folder
from twinct.core.files.writing import complete, storage_errors
from twinct.core.foreign_text import number, quoted, shortened
from twinct.geometry import MM_PER_M
from twinct.robots.cell.own_arms import check_scale
from twinct.robots.cell.urdf_tree import way_to_flange
from twinct.specimen.convex_parts import convex_parts, pieces_or_hull

if TYPE_CHECKING:
    import trimesh

FILE, MESHES = "arm.urdf", "meshes"
"""What the folder holds."""

MOST_PARTS = 8
"""Largest number of parts of a collision mesh; one of more pieces counts as one convex hull."""

LARGEST_FACES = 200
"""Number of triangles to which the hull of a picture is decimated, if it collides."""


@dataclass(frozen=True)
class Written:
    """Result of ``write_arm``.

    Attributes:
        file: the URDF.
        meshes: number of mesh files.
        parts: number of convex parts of each collision mesh with more than one, by its link.
        links: names of all links.
        lacking: joints without torque limit, joints without speed limit, and moving links without
            inertia, by the scenario's key that supplies it.
        disabled: number of pairs of links that an SRDF disables.
        pictures: links that collide by their pictures.
        holed: links that were not cut although asked, because their meshes have holes.
    """

    file: Path
    meshes: int
    parts: Mapping[str, int]
    links: tuple[str, ...]
    lacking: Mapping[str, tuple[str, ...]]
    disabled: int = 0
    pictures: tuple[str, ...] = ()
    holed: tuple[str, ...] = ()


def write_arm(
    file: Path,
    arguments: Mapping[str, str],
    folder: Path,
    *,
    srdf: Path | None = None,
    collide_visuals: bool = False,
    concave: bool = False,
) -> Written:
    """Expand a robot description, and write it with all of its meshes.

    Args:
        file: URDF, or xacro.
        arguments: values of xacro's arguments.
        folder: folder to write, which does not exist.
        srdf: SRDF of the arm, or xacro of one, whose disabled collisions are not checked.
        collide_visuals: whether links without collision shapes collide by their pictures.
        concave: whether hollow pieces of collision meshes are cut into convex parts, instead of
            counting as their hulls.

    Raises:
        MissingExtraError: xacro is needed and not installed.
        ScenarioError: the file, a package or a mesh cannot be read; the meshes are not in m.
        StorageError: the folder cannot be written.
    """
    where, file = str(file), file.resolve()
    root = _robot(file, arguments, where)
    for name in ("gazebo", "transmission", "ros2_control"):
        for element in root.findall(name):
            root.remove(element)
    links = tuple(link.get("name", "") for link in root.findall("link"))
    disabled = () if srdf is None else _disabled(srdf, arguments, links)
    root.extend(ElementTree.Element("disable_collisions", pair) for pair in disabled)
    meshes = _Meshes(file, where, collide_visuals, concave)
    for link in root.findall("link"):
        meshes.place(link)
    meshes.check_scale(root)
    ElementTree.indent(root)
    with storage_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with complete(folder) as draft:
            (draft / MESHES if meshes.written else draft).mkdir(parents=True)
            for name, mesh in meshes.written.items():
                mesh.export(draft / name)
            (draft / FILE).write_text(ElementTree.tostring(root, encoding="unicode") + "\n")
    return Written(
        *(folder / FILE, len(meshes.written), meshes.parts, links, _lacking(root)),
        disabled=len(disabled),
        pictures=tuple(meshes.pictures),
        holed=tuple(dict.fromkeys(meshes.holed)),
    )


def _robot(file: Path, arguments: Mapping[str, str], where: str) -> Any:
    """Return a description without macros.

    Raises:
        MissingExtraError: xacro is needed and not installed.
        ScenarioError: the file cannot be read.
    """
    text = read_bytes(file, where, LARGEST_BYTES, ScenarioError)
    if b"xacro" in text:
        text = _expanded(file, arguments, where).encode()
    elif arguments and file.suffix != ".srdf":
        raise ScenarioError(
            f"{where} has no macros, but arguments are given: {', '.join(arguments)}"
        )
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ScenarioError(f"{where} is not readable XML: {shortened(str(error))}") from None
    if root.tag != "robot":
        raise ScenarioError(f"{where} is not a robot description: it begins with <{root.tag}>")
    return root


def _disabled(
    srdf: Path, arguments: Mapping[str, str], links: tuple[str, ...]
) -> list[dict[str, str]]:
    """Return the pairs of links that an SRDF disables, as attributes.

    Raises:
        MissingExtraError: xacro is needed and not installed.
        ScenarioError: the file cannot be read, or names links of another arm.
    """
    pairs = [
        {key: element.get(key, "") for key in ("link1", "link2", "reason") if element.get(key)}
        for element in _robot(srdf.resolve(), arguments, str(srdf)).findall("disable_collisions")
    ]
    named = {pair.get(key, "") for pair in pairs for key in ("link1", "link2")}
    if unknown := sorted(named - set(links)):
        raise ScenarioError(
            f"{srdf} is of another arm: it names {', '.join(map(quoted, unknown))}, but the links "
            f"are {', '.join(links)}"
        )
    return pairs


def _expanded(file: Path, arguments: Mapping[str, str], where: str) -> str:
    """Return a description without macros.

    Raises:
        MissingExtraError: xacro is not installed.
        ScenarioError: xacro refuses the file.
    """
    require("xacro")
    xacro: Any = import_module("xacro")
    substitution_args: Any = import_module("xacro.substitution_args")

    def find(name: str) -> str:
        if (folder := package_folder(name, file)) is None:
            raise ScenarioError(
                f"{where} needs the package {quoted(name)}, which was not found: it was "
                f"searched in {file.parent} and the folders above, and in {' and '.join(PATHS)}. "
                f"Set {PATHS[0]} to the folder that contains it"
            )
        return str(folder)

    before = substitution_args._eval_find
    substitution_args._eval_find = find
    try:
        with _quiet():
            return xacro.process_file(str(file), mappings=dict(arguments)).toxml()
    except ScenarioError:
        raise
    except Exception as error:  # whatever the file's expressions raise
        if isinstance(cause := getattr(error, "exc", None), ScenarioError):
            raise cause from None
        reason = shortened(" ".join(str(error).split()) or type(error).__name__, 400)
        hint = "; arguments are given as NAME:=VALUE" if "arg" in reason else ""
        raise ScenarioError(f"{where}: xacro cannot expand it: {reason}{hint}") from None
    finally:
        substitution_args._eval_find = before


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep xacro's messages off the terminal: its errors are raised as well."""
    streams = sys.stdout, sys.stderr
    sys.stdout = sys.stderr = StringIO()
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams


class _Meshes:
    """Mesh files of a robot description, as STL under names of their links."""

    def __init__(self, main: Path, where: str, collide_visuals: bool, concave: bool) -> None:
        self._main, self._where = main, where
        self._collide_visuals, self.pictures = collide_visuals, list[str]()
        self._concave, self.holed = concave, list[str]()
        self.written, self.parts = dict[str, "trimesh.Trimesh"](), dict[str, int]()
        self._diagonals = dict[str, float]()

    def place(self, link: Any) -> None:
        """Replace the meshes of a link: pictures as they are, collision meshes by convex parts."""
        name = link.get("name", "")
        if self._collide_visuals and link.find("collision") is None:
            self._copy_visuals(link, name)
        for role in ("visual", "collision"):
            for order, element in enumerate(link.findall(role)):
                mesh = element.find("geometry/mesh")
                if mesh is None:
                    continue
                try:
                    read = self._read(mesh.get("filename", ""))
                except ScenarioError:
                    if role == "visual":  # only the picture loses it
                        link.remove(element)
                        continue
                    raise
                self._measure(mesh, read)
                pieces = [read] if role == "visual" else self._convex(read, mesh, name)
                if role == "collision" and name in self.pictures:
                    pieces = [_decimated(piece) for piece in pieces]
                if len(pieces) > 1:
                    self.parts[name] = self.parts.get(name, 0) + len(pieces)
                at = list(link).index(element)
                link.remove(element)
                for part, piece in enumerate(pieces):
                    copy = deepcopy(element)
                    stem = "_".join((name, role, str(order), *([str(part)] if part else [])))
                    copy.find("geometry/mesh").set("filename", self._kept(piece, stem))
                    link.insert(at + part, copy)

    def _copy_visuals(self, link: Any, name: str) -> None:
        """Let a link collide by its pictures."""
        for visual in link.findall("visual"):
            copy = deepcopy(visual)
            copy.tag = "collision"
            for material in copy.findall("material"):
                copy.remove(material)
            link.append(copy)
        if link.find("collision") is not None:
            self.pictures.append(name)

    def _convex(self, mesh: trimesh.Trimesh, element: Any, link: str) -> Sequence[trimesh.Trimesh]:
        """Return the convex parts of a collision mesh, in the units of its file."""
        if not self._concave:
            return pieces_or_hull(mesh, MOST_PARTS)
        try:
            scale = MM_PER_M * float(
                np.mean(np.array((element.get("scale") or "1").split(), float))
            )
        except ValueError:  # MuJoCo refuses such a scale
            scale = MM_PER_M
        solid = mesh.copy()
        solid.merge_vertices()
        solid.apply_scale(scale)
        shells = solid.split(only_watertight=False, repair=False)
        if not all(shell.is_watertight for shell in shells):
            self.holed.append(link)
            return pieces_or_hull(mesh, MOST_PARTS)
        parts = [part for shell in shells for part in convex_parts(shell)]
        return [part.copy().apply_scale(1 / scale) for part in parts]

    def _measure(self, element: Any, mesh: trimesh.Trimesh) -> None:
        """Keep the diagonal of a mesh with the scale of its element, m."""
        try:
            scale = np.array((element.get("scale") or "1 1 1").split(), float)
            diagonal = float(np.linalg.norm(scale * mesh.extents))
        except ValueError:  # MuJoCo refuses such a scale
            return
        name = element.get("filename", "")
        self._diagonals[name] = max(diagonal, self._diagonals.get(name, 0.0))

    def check_scale(self, root: Any) -> None:
        """Refuse meshes in another unit than the links.

        Raises:
            ScenarioError: the largest mesh is not in m.
        """
        origins = [joint.find("origin") for joint in root.findall("joint")]
        places = [o.get("xyz") or "0 0 0" for o in origins if o is not None]
        try:
            length = sum(float(np.linalg.norm(np.array(p.split(), float))) for p in places)
        except ValueError:  # MuJoCo refuses such a joint
            return
        if self._diagonals and length > 0:
            name, largest = max(self._diagonals.items(), key=lambda one: one[1])
            check_scale(name, largest, length, self._where)

    def _read(self, name: str) -> trimesh.Trimesh:
        """Read a mesh in m.

        Raises:
            ScenarioError: there is no such file, or it is no mesh.
        """
        import trimesh

        file = mesh_file(name, "", self._main, self._where)
        try:
            logging.getLogger("trimesh").setLevel(logging.ERROR)
            read = trimesh.load(file)
            scale = 1.0
            if file.suffix.lower() == ".dae" and read.units not in (None, "meter", "meters", "m"):
                scale = trimesh.units.unit_conversion(read.units, "meters")
            mesh = read.to_mesh() if isinstance(read, trimesh.Scene) else read
            if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
                raise ValueError("it holds no triangles")
        except Exception as error:  # trimesh raises whatever its readers raise
            reason = shortened(" ".join(str(error).split()) or type(error).__name__)
            raise ScenarioError(
                f"{self._where} names {quoted(name)}, but {file} cannot be read: {reason}"
            ) from None
        return mesh.apply_scale(scale) if scale != 1.0 else mesh

    def _kept(self, mesh: trimesh.Trimesh, stem: str) -> str:
        """Keep a mesh, and return the name of its file."""
        safe = "".join(c if c.isalnum() or c in "-_" else "_" for c in stem)
        self.written[name := f"{MESHES}/{safe}.stl"] = mesh
        return name


def _number(text: str, joint: Any, name: str) -> float:
    try:
        return number(text)
    except ValueError as error:
        told = f"{name} of joint {quoted(joint.get('name', ''))}"
        raise ScenarioError(f"{told}: {error}") from None


def _decimated(hull: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return the hull of few of a hull's points, those that are extreme in many directions."""
    import trimesh

    if len(hull.faces) <= LARGEST_FACES:
        return hull
    ways = trimesh.creation.icosphere(subdivisions=3).vertices
    far = np.unique((hull.vertices @ ways.T).argmax(axis=0))
    return hull if len(far) < 4 else trimesh.convex.convex_hull(hull.vertices[far])


def _lacking(root: Any) -> dict[str, tuple[str, ...]]:
    """Return what the arm lacks between root and flange, or any joint if it has no such chain."""
    moved, lacking = (
        set(),
        {"joint_torque_nm": [], "joint_speed_deg_s": [], "link_density_kg_m3": []},
    )
    for joint in way_to_flange(root, None) or root.findall("joint"):
        if joint.get("type") not in ("revolute", "continuous"):
            continue
        child, limit = joint.find("child"), joint.find("limit")
        moved.add("" if child is None else child.get("link", ""))
        for name, key in (("effort", "joint_torque_nm"), ("velocity", "joint_speed_deg_s")):
            if limit is None or not _number(limit.get(name) or "0", joint, name) > 0:
                lacking[key].append(joint.get("name", ""))
    for link in root.findall("link"):
        if link.get("name") in moved and link.find("inertial") is None:
            lacking["link_density_kg_m3"].append(link.get("name", ""))
    return {key: tuple(names) for key, names in lacking.items() if names}
