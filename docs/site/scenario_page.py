"""Every key of a scenario, a study and a measured scan, from the models that validate the files."""

from __future__ import annotations

import inspect
import typing
from typing import Any, Literal

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from twinct.core.settings import annotation_of, facts_of, models_in
from twinct.measured.description import Measured
from twinct.recon.sections.reconstruction import SECTIONS, own_keys
from twinct.scenario import Reconstruction, Scenario
from twinct.scenario.digests import STAGES, declared
from twinct.study.settings import Study

UNITS = {
    "mm": "mm",
    "deg": "deg",
    "deg_s": "deg/s",
    "deg_s2": "deg/s^2",
    "deg_s3": "deg/s^3",
    "mm_s": "mm/s",
    "s": "s",
    "ms": "ms",
    "kg": "kg",
    "kev": "keV",
    "kvp": "kV",
    "ma": "mA",
    "hu": "HU",
    "cm3": "cm^3",
    "g_cm3": "g/cm^3",
}
"""Unit by the suffix of a key; the longest matching suffix applies."""

PICTURES = {
    "source": {
        "energy": "`energy_kev: 50` in place of 80.",
        "spectrum": "`spectrum: {kind: tube, kvp: 80}`.",
        "motion": "`motion_samples: 24`, while the arms turn by 4 degrees.",
        "focal-spot": "`focal_spot: {kind: gaussian, sigma_mm: 1.5}`.",
        "bowtie": "`bowtie: {along: u, angles_deg: [0, 4, 10], thickness_mm: [0, 4, 9]}`, a tube "
        "of 80 kV: the edges harden.",
        "noise": "`current_ma`, `exposure_ms` and `photons_per_mm2_mas` give the photon number: "
        "500 per mm^2 at 1 m, with `detector.noise` of the kind `quantum`.",
    },
    "detector": {
        "response": "`response: {kind: scintillator, thickness_mm: 0.2}`, a tube of 80 kV.",
        "pixel-samples": "`pixel_samples: 4`.",
        "binning": "`binning: 4`.",
        "point-spread": "`point_spread: {kind: gaussian, sigma_mm: 2}`.",
        "noise": "`noise: {kind: quantum}`, 500 photons per mm^2 at 1 m.",
        "readout": "`readout: {bits: 8, free_beam: 200, offset: 5}`, "
        "`noise: {kind: snr, snr: 400}`.",
        "bad-pixels": "`bad_pixels: {kind: random, share: 0.02}`, filled by the correction.",
        "lag": "`lag: 0.3`, from a view 8 degrees away.",
        "correction": "`correction: {flat_frames: 1, flat_geometry: first}`, "
        "`noise: {kind: snr, snr: 60}`.",
        "scatter": "`scatter: {kind: monte_carlo}`.",
        "grid": "`grid: {along: v, ratio: 10, lines_per_cm: 40, strip_mm: 0.043, focus_mm: 1000}`, "
        "`scatter: {kind: monte_carlo}`.",
    },
    "reconstruction": {
        "beam-hardening": "`beam_hardening: null`, `{kind: one_material, material: bone}` and "
        "`{kind: two_materials}`: a small head, less the truth at the mean energy, 1/cm.",
    },
}
"""Captions by section and by name of the picture in ``docs/pictures/physics.py``."""


def scenario() -> str:
    """Return a table of keys for each section of a scenario."""
    return _file(Scenario)


def measured() -> str:
    """Return a table of keys for each section of the description of a measured scan."""
    return _file(Measured)


def study() -> str:
    """Return a table of keys for each section of a study file."""
    return _file(Study)


def _file(model: type[BaseModel]) -> str:
    sections: list[str] = []
    _write(model, model.__name__, sections, set())
    return "\n".join(sections)


def stages() -> str:
    """Return the table of the stages and the keys that they read."""
    rows = ["| stage | reads | depends on |", "|---|---|---|"]
    for name, stage in STAGES.items():
        keys = dict.fromkeys(key for key, stages in declared(Scenario) if name in stages)
        reads = ", ".join(f"`{key}`" for key in keys)  # two kinds of cell share some keys
        rows.append(f"| {name} | {reads} | {', '.join(stage.on)} |")
    return "\n".join(rows) + "\n"


def _about(model: type[BaseModel]) -> str:
    return inspect.cleandoc(model.__doc__ or "").replace("``", "`")


def _write(
    model: type[BaseModel], title: str, sections: list[str], seen: set[type[BaseModel]]
) -> None:
    if model in seen:
        return
    seen.add(model)
    rows = [f"## {title}\n", f"{_about(model)}\n"]
    rows += ["| key | value | unit | default | meaning | source |", "|---|---|---|---|---|---|"]
    inner: list[tuple[type[BaseModel], str]] = []
    own = list(model.model_fields)
    if model is not Reconstruction and issubclass(model, Reconstruction):
        own = own_keys(model)
    for name in own:
        info = model.model_fields[name]
        models = models_in(annotation_of(info))
        inner += [(Reconstruction, name)] * (name == "reconstruction")
        inner += [(m, f"{_title(title)}{name}{_kind(m)}") for m in models]
        facts = facts_of(info)
        rows.append(
            f"| `{name}` | {_value(name, info)} | {_unit(name, facts)} "
            f"| {_default(info)} | {_meaning(name, info)} | {facts.get('x-source', '')} |"
        )
    for picture, caption in PICTURES.get(title, {}).items():
        rows += ["", caption, "", f"![](images/physics-{picture}.png)"]
    sections.append("\n".join(rows) + "\n")
    for other, name in inner:
        _write(other, name, sections, seen)


def _value(name: str, info: Any) -> str:
    if info is Reconstruction.model_fields.get(name) and name == "algorithm":
        return " or ".join(f"`{name}`" for name in SECTIONS)
    return _type(annotation_of(info), info.metadata)


def _unit(name: str, facts: dict[str, Any]) -> str:
    if "x-unit" in facts:
        return facts["x-unit"]
    ends = (end for end in sorted(UNITS, key=len, reverse=True))
    return next((UNITS[end] for end in ends if f"_{name}".endswith(f"_{end}")), "")


def _meaning(name: str, info: Any) -> str:
    return info.description or {"kind": "Selects this section."}[name]


def _title(title: str) -> str:
    whole = title in (Scenario.__name__, Measured.__name__, Study.__name__)
    return "" if whole else title.split(" (")[0] + "."


def _kind(model: type[BaseModel]) -> str:
    for tag in ("kind", "algorithm", "method"):
        if info := model.model_fields.get(tag):
            return f" ({tag}: {typing.get_args(info.annotation)[0]})"
    return ""


def _type(annotation: Any, metadata: list[Any]) -> str:
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Literal:
        text = " or ".join(f"`{arg}`" for arg in args)
    elif origin is typing.Annotated:
        text = _type(args[0], list(args[1:]))
    elif origin is tuple:
        many = len(args) == 2 and args[1] is Ellipsis
        one = _type(args[0], [])
        text = f"list of {one}" if many else f"{len(args)} {_several(one)}"
    elif args and origin is not dict:
        text = " or ".join(dict.fromkeys(_type(arg, []) for arg in args if arg is not type(None)))
    elif origin is dict:
        numbers = args[1] in (int, float)
        text = "mapping of names to numbers" if numbers else "mapping"
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        text = "section"
    else:
        names = {
            "JsonValue": "value",
            "str": "text",
            "float": "number",
            "int": "whole number",
            "bool": "true or false",
        }
        name = getattr(annotation, "__name__", str(annotation))
        text = names.get(name, name.lower())
    return text + _bounds(metadata)


def _several(one: str) -> str:
    return "numbers" if "number" in one else f"of {one}"


def _bounds(metadata: list[Any]) -> str:
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    bounds = []
    for item in metadata:
        items = getattr(item, "metadata", None) or [item]
        for bound in items:
            for name, sign in signs.items():
                if (value := getattr(bound, name, None)) is not None:
                    bounds.append(f"{sign} {value:g}")
    return f" {', '.join(bounds)}" if bounds else ""


def _default(info: Any) -> str:
    if info.default_factory is not None:
        return "see its section"
    if info.default is PydanticUndefined:
        return "**needed**"
    if info.default is None or info.default == "":
        return "none"
    if isinstance(info.default, BaseModel) and not hasattr(info.default, "kind"):
        return "see its section"
    return f"`{_plain(info.default)}`"


def _plain(value: Any) -> str:
    if isinstance(value, BaseModel):
        keys = ("kind",) if hasattr(value, "kind") else tuple(type(value).model_fields)
        given = {key: getattr(value, key) for key in keys}
        return f"{{{', '.join(f'{key}: {_plain(item)}' for key, item in given.items())}}}"
    if isinstance(value, tuple):
        return f"[{', '.join(_plain(item) for item in value)}]"
    if isinstance(value, bool):
        return f"{value}".lower()
    return f"{value:g}" if isinstance(value, float) else f"{value}"
