"""A CTSimU scenario: read, checked, and given frame by frame."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xraylib

from twinct.ctsimu.placement import place
from twinct.ctsimu.reader import UNITS, Moment, Section
from twinct.ctsimu.scene import Body, FieldImages, Frame, Layer, RawImage, Response, Spot, Tube
from twinct.errors import ScenarioError, SpecimenError
from twinct.geometry import Panel, ScanGeometry
from twinct.specimen import Material

FORMAT = (1, 2)
"""Newest version of the file format that is understood; older ones down to 1.0 are subsets."""

RAW_KINDS = ("uint8", "int8", "uint16", "int16", "float32", "float64")


@dataclass(frozen=True, eq=False)
class CtsimuScenario:
    """A scenario file that was read and is supported in full.

    Attributes:
        path: the file.
        data: its content.
        frames: number of projections.
        average: frames averaged for each projection.
        dark: dark images.
        flat: flat images.
    """

    path: Path
    data: Mapping[str, Any]
    frames: int
    average: int
    dark: FieldImages
    flat: FieldImages

    @property
    def name(self) -> str:
        """Stem of the file: images are called after it."""
        return self.path.stem

    def frame(self, index: float, believed: bool = False) -> Frame:
        """All of one frame.

        Args:
            index: counted from 0.
            believed: as reconstruction is told: without unknown deviations and drifts.

        Raises:
            ScenarioError: what only this frame says is wrong or not supported.
        """
        problems: list[str] = []
        frame = _frame(self._root(Moment(index, self.frames, believed), problems))
        if problems or frame is None:
            raise ScenarioError([f"{self.path}: {p}" for p in problems])
        return frame

    def geometry(self, believed: bool = False) -> ScanGeometry:
        """All views in the frame of the stage, where the reconstructed volume is at rest.

        Args:
            believed: as reconstruction is told; otherwise as executed.
        """
        frames = [self.frame(i, believed) for i in range(self.frames)]
        views = [frame.world_from_stage.inverse() @ frame.view for frame in frames]
        return ScanGeometry(
            *(np.concatenate([getattr(v, n) for v in views]) for n in ("source", "detector")),
            *(np.concatenate([getattr(v, n) for v in views]) for n in ("u", "v")),
            views[0].panel,
        )

    def _root(self, moment: Moment, problems: list[str]) -> Section:
        return Section(self.data, "", moment, self.path.parent, problems)


def load_ctsimu(path: str | Path) -> CtsimuScenario:
    """Read a CTSimU scenario file, all frames of it.

    Raises:
        ScenarioError: with one sentence for each thing that is wrong, missing or not supported.
    """
    path = Path(path).expanduser()
    try:
        data = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise ScenarioError(f"{path}: cannot read the scenario: {reason}") from None
    except json.JSONDecodeError as error:
        raise ScenarioError(f"{path}:{error.lineno}: not valid JSON: {error.msg}") from None
    if not isinstance(data, dict):
        raise ScenarioError(f"{path}: a CTSimU scenario is a JSON object")
    problems: list[str] = []
    frames = _frames(data)
    scenario = CtsimuScenario(path, data, frames, 1, *2 * [FieldImages(0, 1, False, False)])
    root = scenario._root(Moment(0, frames), problems)
    _check_version(root.section("file"))
    acquisition = root.section("acquisition")
    average = acquisition.whole("frame_average", 1)
    dark, flat = (_field_images(acquisition.section(f"{kind}_field")) for kind in ("dark", "flat"))
    if frames < 1 or average < 1:
        acquisition.problem("number_of_projections, frame_average", "must be at least 1")
    if flat.correction and not flat.number:
        acquisition.problem("flat_field.correction", "needs flat_field.number of at least 1")
    if not problems:
        for index in range(frames):
            _frame(scenario._root(Moment(index, frames), problems))
    if problems:
        raise ScenarioError([f"{path}: {problem}" for problem in problems])
    return CtsimuScenario(path, data, frames, average, dark, flat)


def _frames(data: Mapping[str, Any]) -> int:
    acquisition = data.get("acquisition")
    number = acquisition.get("number_of_projections") if isinstance(acquisition, Mapping) else None
    return int(number) if isinstance(number, int | float) and number >= 1 else 1


def _check_version(section: Section) -> None:
    kind = section.text("file_type")
    if kind != "CTSimU Scenario":
        section.problem("file_type", f"{kind!r} is not 'CTSimU Scenario'")
    version = section.section("file_format_version")
    found = version.whole("major", 0), version.whole("minor", 0)
    if not (1, 0) <= found <= FORMAT:
        section.problem("file_format_version", f"{found[0]}.{found[1]} is not one of 1.0, 1.1, 1.2")


def _field_images(section: Section) -> FieldImages:
    return FieldImages(
        section.whole("number", 0),
        section.whole("frame_average", 1),
        section.flag("ideal", False),
        section.flag("correction", False),
    )


def _frame(root: Section) -> Frame | None:
    """One frame; None after noting what is wrong."""
    root.skip("file", "simulation")
    acquisition = root.section("acquisition")
    turn, exposure_fields = _stage_turn(acquisition), ("dark_field", "flat_field")
    acquisition.skip("number_of_projections", "frame_average", *exposure_fields)
    if acquisition.flag("scattering", False):
        acquisition.problem("scattering", "true is not supported: no scattered radiation here")
    binning = acquisition.section("pixel_binning")
    binned = binning.whole("u", 1), binning.whole("v", 1)
    geometry, materials = root.section("geometry"), _materials(root)
    source = place(geometry.section("source"))
    source_section = geometry.section("source")
    if (source_section.text("type", ("cone",)) or "cone") == "cone":
        divergence = source_section.section("beam_divergence")
        if divergence.number("u", "deg") or divergence.number("v", "deg"):
            source_section.problem("beam_divergence", "is not supported: a cone has none")
    stage = place(geometry.section("stage"), turn_deg=turn).outer_from_part
    detector = place(geometry.section("detector")).outer_from_part
    panel_section = root.section("detector")
    exposure = panel_section.number("integration_time", "s")
    panel = _panel(panel_section, binned)
    response = _response(panel_section, materials)
    tube, spot = _tube(root.section("source"), materials)
    bodies = [_body(s, stage, materials) for s in root.sections("samples")]
    environment = _environment(root.section("environment"), materials)
    root.finish()
    if root.problems or panel is None:
        return None
    source_pose = source.outer_from_part
    u, v_down, w = detector.rotation.T
    upside_down = bool(w @ (source_pose.position - detector.position) < 0)
    view = ScanGeometry(
        source_pose.position[None],
        detector.position[None],
        u[None],
        -v_down[None] if upside_down else v_down[None],
        panel,
    )
    return Frame(
        view,
        upside_down,
        source_pose.rotation[:, :2].T.copy(),
        spot,
        stage,
        tuple(body for body in bodies if body is not None),
        environment,
        tube,
        response,
        1.0 if exposure is None else exposure,
        binned,
    )


def _stage_turn(section: Section) -> float:
    """Angle of the stage about its w, degrees."""
    start, stop = section.number("start_angle", "deg"), section.number("stop_angle", "deg")
    start, stop = start or 0.0, stop or 0.0
    if stop < start:
        section.problem("stop_angle", f"{stop:g} deg is less than start_angle {start:g} deg")
    direction = section.text("direction", ("CCW", "CW")) or "CCW"
    moment = section.moment
    steps = moment.frames - 1 if section.flag("include_final_angle", True) else moment.frames
    section.text("scan_mode", ("stop+go",))
    if section.number("scan_speed", "deg/s"):
        section.problem("scan_speed", "is not supported: the stage stops for every frame")
    angle = start + (stop - start) * moment.frame / steps if steps else start
    return -angle if direction == "CW" else angle


def _panel(section: Section, binning: tuple[int, int]) -> Panel | None:
    columns, rows = section.whole("columns", 0, "px"), section.whole("rows", 0, "px")
    pitch = section.section("pixel_pitch")
    pitch_u, pitch_v = pitch.needed("u", "mm"), pitch.needed("v", "mm")
    if min(columns, rows) < 1 or min(pitch_u, pitch_v) <= 0:
        section.problem("columns, rows, pixel_pitch", "must all be positive")
        return None
    if min(binning) < 1 or columns % binning[0] or rows % binning[1]:
        section.problem("columns, rows", f"cannot be binned {binning[0]} x {binning[1]}")
    return Panel(rows, columns, pitch_u, pitch_v)


def _response(section: Section, materials: dict[str, Material | None]) -> Response:
    # Without scatter nothing comes back from behind; gain and dead time are documentation.
    section.skip("model", "manufacturer", "dead_time", "gain")
    kind = section.text("type", ("ideal", "real")) or "ideal"
    grey, noise = section.section("gray_value"), section.section("noise")
    blur = section.section("unsharpness")
    layers: list[Layer] = []
    for name in ("window", "filters"):
        sided = section.section(name)
        layers += _layers(sided, "front", materials)
        _layers(sided, "rear", materials)
    scintillator = _layer(section.section("scintillator"), materials)
    efficiency = grey.file("efficiency_characteristics_file")
    if kind == "real" and scintillator is None and efficiency is None:
        section.problem("scintillator", "a real detector needs one, or an efficiency file")
    factor, offset = grey.number("factor", "1/J"), grey.number("offset")
    imin, imax = grey.number("imin"), grey.number("imax")
    bits = section.whole("bit_depth", 16)
    if not 1 <= bits <= 16:
        section.problem("bit_depth", f"{bits} is not supported: 1 to 16")
    return Response(
        kind == "real",
        scintillator,
        tuple(layers),
        efficiency,
        0.0 if imin is None else imin,
        60000.0 if imax is None else imax,
        factor,
        offset,
        grey.file("intensity_characteristics_file"),
        bits,
        noise.number("snr_at_imax") or None,
        noise.file("noise_characteristics_file"),
        blur.number("basic_spatial_resolution", "mm") or 0.0,
        blur.file("mtf"),
        section.number("image_lag") or 0.0,
        _raw_image(section.section("bad_pixel_map"), (0, 0)),
    )


def _tube(section: Section, materials: dict[str, Material | None]) -> tuple[Tube, Spot]:
    section.skip("model", "manufacturer")
    spectrum, target = section.section("spectrum"), section.section("target")
    monochromatic, file = spectrum.flag("monochromatic", False), spectrum.file("file")
    for name in ("bremsstrahlung", "characteristic"):  # keys of format 1.0
        if spectrum.flag(name, True) is False and not monochromatic and file is None:
            spectrum.problem(name, "false is not supported: a tube emits both")
    symbol, angle = target.text("material_id"), target.section("angle")
    take_off, kind = angle.number("emission", "deg"), target.text("type")
    angle.number("incidence", "deg"), target.number("thickness", "mm")
    if not monochromatic and file is None:
        target_material = materials.get(symbol or "")
        elements = list(target_material.mass_fractions) if target_material else []
        if elements != ["W"] or kind == "transmission":
            target.problem("", "a spectrum is calculated for reflection targets of tungsten only")
    spot = section.section("spot")
    size, sigma = spot.section("size"), spot.section("sigma")
    if size.number("w", "mm") or sigma.number("w", "mm"):
        spot.problem("size.w, sigma.w", "a focal spot with depth is not supported")
    picture = spot.section("intensity_map")
    if picture.whole("dim_z", 0) > 1:
        picture.problem("dim_z", "a focal spot with depth is not supported")
    shape = picture.whole("dim_x", 0), picture.whole("dim_y", 0)
    profile = Spot(
        (size.number("u", "mm") or 0.0, size.number("v", "mm") or 0.0),
        (sigma.number("u", "mm") or 0.0, sigma.number("v", "mm") or 0.0),
        _raw_image(picture, shape),
    )
    if profile.image is not None and min(profile.size_mm) <= 0:
        spot.problem("size", "an intensity_map needs the size of its rectangle")
    tube = Tube(
        section.needed("voltage", "kV"),
        section.number("current", "mA") or 0.0,
        monochromatic and file is None,
        file,
        tuple(_layers(section, "window", materials)),
        tuple(_layers(section, "filters", materials)),
        symbol,
        take_off,
    )
    if tube.voltage_kv <= 0:
        section.problem("voltage", f"{tube.voltage_kv:g} kV must be positive")
    return tube, profile


def _raw_image(section: Section, shape: tuple[int, int]) -> RawImage | None:
    path = section.file("file")
    kind = section.text("type", RAW_KINDS) or "uint16"
    endian = section.text("endian", ("little", "big")) or "little"
    header = section.whole("headersize", 0)
    if path is None:
        return None
    order = "<" if endian == "little" else ">"
    return RawImage(path, np.dtype(kind).newbyteorder(order).str, shape[0], shape[1], header)


def _body(section: Section, stage: Any, materials: dict[str, Material | None]) -> Body | None:
    name = section.text("name") or section.place
    file, unit = section.file("file"), section.text("unit") or "mm"
    if unit not in UNITS["mm"]:
        section.problem("unit", f"{unit!r} is not one of {', '.join(map(str, UNITS['mm']))}")
    factors = section.section("scaling_factor")
    scale = [1.0 if (f := factors.number(axis)) is None else f for axis in "rst"]
    if min(scale) <= 0:
        section.problem("scaling_factor", f"{scale} must be positive")
    position = section.section("position")
    placed = place(position, world_from_stage=stage, vectors=("vector_r", "vector_t"))
    pose = stage @ placed.outer_from_part if placed.on_stage else placed.outer_from_part
    material = _of(section, materials)
    if file is None:
        if not section.has("file"):
            section.problem("file", "is missing")
        return None
    mm = UNITS["mm"].get(unit, 1.0)
    return Body(name, file, (mm * scale[0], mm * scale[1], mm * scale[2]), material, pose)


def _environment(section: Section, materials: dict[str, Material | None]) -> Material | None:
    section.skip("temperature")  # the density is the material's
    return _of(section, materials) if section.has("material_id") else None


def _layers(section: Section, key: str, materials: dict[str, Material | None]) -> list[Layer]:
    found = [_layer(item, materials) for item in section.sections(key)]
    return [layer for layer in found if layer is not None]


def _layer(section: Section, materials: dict[str, Material | None]) -> Layer | None:
    thickness = section.number("thickness", "mm")
    if not section.has("material_id") and not thickness:
        section.skip("material_id")
        return None
    material = _of(section, materials)
    if thickness is None or thickness < 0:
        section.problem("thickness", "must be a length of at least 0")
    return Layer(material, thickness) if material and thickness else None


def _of(section: Section, materials: dict[str, Material | None]) -> Material | None:
    name = section.text("material_id")
    if name not in materials:
        known = ", ".join(materials) or "none"
        section.problem("material_id", f"{name!r} is not among the materials: {known}")
    return materials.get(name or "")


def _materials(root: Section) -> dict[str, Material | None]:
    """By id; None for one of no density: vacuum."""
    found: dict[str, Material | None] = {}
    for section in root.sections("materials"):
        name = section.text("id") or section.place
        section.skip("name")
        density = section.needed("density", "g/cm^3")
        shares: dict[str, float] = {}
        for part in section.sections("composition"):
            formula, weight = part.text("formula"), part.number("mass_fraction")
            weight = 1.0 if weight is None else weight
            if density > 0 and weight > 0:
                _add(part, formula or "", weight, shares)
        if density <= 0:
            found[name] = None
            continue
        total = sum(shares.values())
        if total <= 0:
            section.problem("composition", "holds no elements")
            found[name] = None
            continue
        try:
            found[name] = Material(name, density, {s: w / total for s, w in shares.items()})
        except SpecimenError as error:
            section.problem("composition", str(error))
    return found


def _add(section: Section, formula: str, weight: float, shares: dict[str, float]) -> None:
    try:
        parsed = xraylib.CompoundParser("".join(formula.split()))
    except ValueError as error:
        section.problem("formula", f"{formula!r} cannot be read: {error}")
        return
    for number, share in zip(parsed["Elements"], parsed["massFractions"], strict=True):
        symbol = xraylib.AtomicNumberToSymbol(number)
        shares[symbol] = shares.get(symbol, 0.0) + weight * share
