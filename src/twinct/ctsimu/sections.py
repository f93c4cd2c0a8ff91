"""Reader for the sections of a CTSimU file, which make a frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twinct.core.files.images import RawImage
from twinct.ctsimu import ranges
from twinct.ctsimu.acquisition import check_header, read_acquisition, read_turn
from twinct.ctsimu.drifts import short
from twinct.ctsimu.materials import Materials, read_materials
from twinct.ctsimu.placement import place
from twinct.ctsimu.reader import UNITS, JsonSection
from twinct.ctsimu.scene import FocalSpot, Frame, Layer, PanelResponse, Sample, Tube
from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.specimen import Material

MAX_PIXELS = 2**28
"""Maximum size of a panel: 16384 x 16384. The signal of a frame alone takes 2 GB."""

IN_PLANE_MM = 1e-6
"""Minimum distance of the source from the panel's plane."""

TARGETS = ("reflection", "transmission")
RAW_KINDS = ("uint8", "int8", "uint16", "int16", "float32", "float64")


def read_frame(root: JsonSection) -> Frame | None:
    """Return one frame with all its settings. Report problems, and return None if invalid."""
    root.skip("simulation")
    check_header(root.section("file", needed=True))
    acquisition = root.section("acquisition", needed=True)
    read_acquisition(acquisition)
    turn, binning = read_turn(acquisition), acquisition.section("pixel_binning")
    binned = binning.whole("u", 1, "", ranges.COUNT), binning.whole("v", 1, "", ranges.COUNT)
    if acquisition.flag("scattering", False):
        acquisition.problem(
            "scattering", "true is not supported: scattered radiation is not simulated"
        )
    geometry, materials = root.section("geometry", needed=True), read_materials(root)
    source_section = geometry.section("source", needed=True)
    source = place(source_section)
    source_section.text("type", ("cone",))
    divergence = source_section.section("beam_divergence")
    if divergence.number("u", "deg") or divergence.number("v", "deg"):
        source_section.problem("beam_divergence", "is not supported: a cone has none")
    stage = place(geometry.section("stage", needed=True), turn_deg=turn)
    detector = place(geometry.section("detector", needed=True))
    panel_section = root.section("detector", needed=True)
    exposure_s = panel_section.number("integration_time", "s", ranges.POSITIVE) or 1.0
    panel = _panel(panel_section, binned)
    response = _response(panel_section, materials)
    tube, spot = _tube(root.section("source", needed=True), materials)
    in_joule = response.curve is not None or None not in (response.factor, response.offset)
    if in_joule and tube.monochromatic:
        panel_section.problem(
            "gray_value",
            "grey values for an energy in J need a source with a known number of photons, which a "
            "monochromatic source does not have: give imin and imax",
        )
    read_samples = [_sample(s, stage, materials) for s in root.sections("samples")]
    samples = tuple(sample for sample in read_samples if sample is not None)
    room = _environment(root.section("environment"), materials)
    u, v_down, w = detector.rotation.T
    distance_mm = float(w @ (source.position - detector.position))
    root.finish()
    if not root.problems and abs(distance_mm) < IN_PLANE_MM:
        geometry.problem("detector", "the source lies in the plane of the panel")
    if root.problems or panel is None:
        return None
    upside_down = distance_mm < 0
    v = -v_down if upside_down else v_down
    view = ScanGeometry(source.position[None], detector.position[None], u[None], v[None], panel)
    axes = source.rotation[:, :2].T.copy()
    return Frame(
        view, upside_down, axes, spot, stage, samples, room, tube, response, exposure_s, binned
    )


def _panel(section: JsonSection, binning: tuple[int, int]) -> Panel | None:
    section.require("columns", "rows")
    columns = section.whole("columns", 0, "px", ranges.PIXELS)
    rows = section.whole("rows", 0, "px", ranges.PIXELS)
    pitch = section.section("pixel_pitch", needed=True)
    pitch_u, pitch_v = pitch.needed("u", "mm", ranges.EDGE), pitch.needed("v", "mm", ranges.EDGE)
    if min(columns, rows) < 1 or not (pitch_u > 0 and pitch_v > 0):
        return None  # already reported
    size = f"{columns} x {rows}"
    if columns * rows > MAX_PIXELS:
        section.problem("columns, rows", f"{size} pixels are more than the {MAX_PIXELS} allowed")
    if columns % binning[0] or rows % binning[1]:
        section.problem("columns, rows", f"{size} cannot be binned {binning[0]} x {binning[1]}")
    return Panel(rows, columns, pitch_u, pitch_v)


def _response(section: JsonSection, materials: Materials) -> PanelResponse:
    # Nothing returns from behind without scatter; gain and dead time are documentation.
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
    factor = grey.number("factor", "1/J", ranges.GREY_PER_J)
    offset = grey.number("offset", "", ranges.GREY)
    curve = grey.file("intensity_characteristics_file")
    if (factor is None) != (offset is None) and grey.has("factor") != grey.has("offset"):
        grey.problem("factor, offset", "one of them is missing")
    imin, imax = grey.number("imin", "", ranges.GREY), grey.number("imax", "", ranges.GREY)
    imin, imax = 0.0 if imin is None else imin, 60000.0 if imax is None else imax
    if not imax > imin:
        grey.problem("imax", f"{imax:g} must be above imin, {imin:g}")
    return PanelResponse(
        kind == "real",
        scintillator,
        tuple(layers),
        efficiency,
        imin,
        imax,
        factor,
        offset,
        curve,
        section.whole("bit_depth", 16, "", ranges.BITS),
        noise.number("snr_at_imax", "", ranges.POSITIVE),
        noise.file("noise_characteristics_file"),
        blur.number("basic_spatial_resolution", "mm", ranges.LENGTH) or 0.0,
        blur.file("mtf"),
        section.number("image_lag", "", ranges.LAG) or 0.0,
        _image(section.section("bad_pixel_map"), (0, 0)),
    )


def _tube(section: JsonSection, materials: Materials) -> tuple[Tube, FocalSpot]:
    section.skip("model", "manufacturer")
    spectrum, target = section.section("spectrum"), section.section("target")
    monochromatic, file = spectrum.flag("monochromatic", False), spectrum.file("file")
    for name in ("bremsstrahlung", "characteristic"):  # keys of format 1.0
        if spectrum.flag(name, True) is False and not monochromatic and file is None:
            spectrum.problem(name, "false is not supported: a tube emits both")
    symbol, angle = target.text("material_id"), target.section("angle")
    take_off, kind = angle.number("emission", "deg", ranges.TAKE_OFF), target.text("type", TARGETS)
    made_of = _of(target, materials) if symbol is not None else None
    for inner, key, unit in ((angle, "incidence", "deg"), (target, "thickness", "mm")):
        inner.number(key, unit)  # documentation, but needs the right unit
    if not monochromatic and file is None:
        elements = list(made_of.mass_fractions) if made_of else []
        if elements != ["W"] or kind == "transmission":
            section.problem(
                "target",
                "a spectrum is calculated for reflection targets of tungsten only; any other needs "
                "spectrum.file",
            )
    tube = Tube(
        section.needed("voltage", "kV", ranges.VOLTAGE),
        section.number("current", "mA", ranges.NOT_NEGATIVE) or 0.0,
        monochromatic and file is None,
        file,
        tuple(_layers(section, "window", materials)),
        tuple(_layers(section, "filters", materials)),
        take_off,
    )
    if not tube.monochromatic and tube.current_ma == 0:
        section.require("current")
        if section.number("current", "mA") == 0:
            section.problem("current", "0 mA gives no radiation")
    return tube, _spot(section.section("spot"))


def _spot(section: JsonSection) -> FocalSpot:
    size, sigma = section.section("size"), section.section("sigma")
    if size.number("w", "mm") or sigma.number("w", "mm"):
        section.problem("size.w, sigma.w", "a focal spot with depth is not supported")
    picture = section.section("intensity_map")
    if picture.whole("dim_z", 0) > 1:
        picture.problem("dim_z", "a focal spot with depth is not supported")
    across, down = (picture.whole(k, 0, "", ranges.NOT_NEGATIVE) for k in ("dim_x", "dim_y"))
    profile = FocalSpot(_lengths(size), _lengths(sigma), _image(picture, (across, down)))
    if isinstance(profile.image, RawImage) and min(across, down) < 1:
        picture.problem("dim_x, dim_y", "a raw file needs both")
    if profile.image is not None and min(profile.size_mm) <= 0:
        section.problem("size", "an intensity_map needs the size of its rectangle")
    return profile


def _lengths(section: JsonSection) -> tuple[float, float]:
    u, v = (section.number(axis, "mm", ranges.LENGTH) or 0.0 for axis in "uv")
    return u, v


def _image(section: JsonSection, shape: tuple[int, int]) -> Path | RawImage | None:
    path = section.file("file")
    kind = section.text("type", RAW_KINDS) or "uint16"
    endian = section.text("endian", ("little", "big")) or "little"
    header = section.whole("headersize", 0, "", ranges.NOT_NEGATIVE)
    if path is None or kind not in RAW_KINDS:
        return None
    if path.suffix.lower() in (".tif", ".tiff"):
        return path
    order = "<" if endian == "little" else ">"
    return RawImage(path, np.dtype(kind).newbyteorder(order).str, shape[0], shape[1], header)


def _sample(section: JsonSection, stage: Pose, materials: Materials) -> Sample | None:
    name = section.text("name") or section.place
    file, unit = section.file("file"), section.text("unit") or "mm"
    if unit not in UNITS["mm"]:
        section.problem("unit", f"{short(unit)} is not one of {', '.join(map(str, UNITS['mm']))}")
    factors = section.section("scaling_factor")
    scale = [factors.number(axis, "", ranges.EDGE) or 1.0 for axis in "rst"]
    position = section.section("position", needed=True)
    pose = place(position, world_from_stage=stage, vectors=("vector_r", "vector_t"))
    material = _of(section, materials)
    section.require("file")
    if file is None:
        return None
    mm = UNITS["mm"].get(unit, 1.0)
    return Sample(name, file, (mm * scale[0], mm * scale[1], mm * scale[2]), material, pose)


def _environment(section: JsonSection, materials: Materials) -> Material | None:
    section.skip("temperature")  # the density is the material's
    section.may_be_empty("material_id")
    return _of(section, materials) if section.has("material_id") else None


def _layers(section: JsonSection, key: str, materials: Materials) -> list[Layer]:
    layers = [_layer(item, materials) for item in section.sections(key)]
    return [layer for layer in layers if layer is not None]


def _layer(section: JsonSection, materials: Materials) -> Layer | None:
    thickness = section.number("thickness", "mm", ranges.LENGTH)
    if not section.has("material_id") and not thickness:
        section.may_be_empty("material_id")
        return None
    material = _of(section, materials)
    section.require("thickness")
    return Layer(material, thickness) if material and thickness else None


def _of(section: JsonSection, materials: Materials) -> Material | None:
    name = section.text("material_id")
    section.require("material_id")
    if name is not None and name not in materials:
        known = ", ".join(materials) or "none"
        section.problem("material_id", f"{short(name)} is not among the materials: {known}")
    return materials.get(name or "")
