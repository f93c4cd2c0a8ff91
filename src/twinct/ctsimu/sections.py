"""The sections of a CTSimU file, read into a frame."""

from __future__ import annotations

import numpy as np

from twinct.ctsimu.materials import Materials, read_materials
from twinct.ctsimu.placement import place
from twinct.ctsimu.reader import UNITS, Section
from twinct.ctsimu.scene import Body, Frame, Layer, RawImage, Response, Spot, Tube
from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.specimen import Material

RAW_KINDS = ("uint8", "int8", "uint16", "int16", "float32", "float64")


def read_frame(root: Section) -> Frame | None:
    """All of one frame; None after noting what is wrong."""
    root.skip("file", "simulation")
    acquisition = root.section("acquisition")
    turn, exposure_fields = _stage_turn(acquisition), ("dark_field", "flat_field")
    acquisition.skip("number_of_projections", "frame_average", *exposure_fields)
    if acquisition.flag("scattering", False):
        acquisition.problem("scattering", "true is not supported: no scattered radiation here")
    binning = acquisition.section("pixel_binning")
    binned = binning.whole("u", 1), binning.whole("v", 1)
    geometry, materials = root.section("geometry"), read_materials(root)
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
    in_joule = response.curve is not None or None not in (response.factor, response.offset)
    if in_joule and tube.monochromatic:
        panel_section.problem(
            "gray_value",
            "a grey value for an energy in J needs a source whose number of photons is known, and "
            "a monochromatic one has none: give imin and imax",
        )
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


def _response(section: Section, materials: Materials) -> Response:
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


def _tube(section: Section, materials: Materials) -> tuple[Tube, Spot]:
    section.skip("model", "manufacturer")
    spectrum, target = section.section("spectrum"), section.section("target")
    monochromatic, file = spectrum.flag("monochromatic", False), spectrum.file("file")
    for name in ("bremsstrahlung", "characteristic"):  # keys of format 1.0
        if spectrum.flag(name, True) is False and not monochromatic and file is None:
            spectrum.problem(name, "false is not supported: a tube emits both")
    symbol, angle = target.text("material_id"), target.section("angle")
    take_off, kind = angle.number("emission", "deg"), target.text("type")
    for inner, key, unit in ((angle, "incidence", "deg"), (target, "thickness", "mm")):
        inner.number(key, unit)  # documentation, but with the right unit
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


def _body(section: Section, stage: Pose, materials: Materials) -> Body | None:
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


def _environment(section: Section, materials: Materials) -> Material | None:
    section.skip("temperature")  # the density is the material's
    return _of(section, materials) if section.has("material_id") else None


def _layers(section: Section, key: str, materials: Materials) -> list[Layer]:
    found = [_layer(item, materials) for item in section.sections(key)]
    return [layer for layer in found if layer is not None]


def _layer(section: Section, materials: Materials) -> Layer | None:
    thickness = section.number("thickness", "mm")
    if not section.has("material_id") and not thickness:
        section.skip("material_id")
        return None
    material = _of(section, materials)
    if thickness is None or thickness < 0:
        section.problem("thickness", "must be a length of at least 0")
    return Layer(material, thickness) if material and thickness else None


def _of(section: Section, materials: Materials) -> Material | None:
    name = section.text("material_id")
    if name not in materials:
        known = ", ".join(materials) or "none"
        section.problem("material_id", f"{name!r} is not among the materials: {known}")
    return materials.get(name or "")
