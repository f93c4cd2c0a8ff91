"""Write docs/scenario.md: every key of a scenario, from the models that validate it."""

from __future__ import annotations

import inspect
import sys
import typing
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from twinct.core.settings import annotation_of, facts_of, models_in
from twinct.recon.sections.reconstruction import SECTIONS, own_keys
from twinct.scenario import Reconstruction, Scenario
from twinct.scenario.digests import STAGES, declared

PAGE = Path(__file__).parents[1] / "docs" / "scenario.md"

HEAD = """# Scenario reference

One YAML file describes a whole simulation. This page is generated from the models that validate the
file (`make docs`); `twinct schema` prints these models as a JSON Schema, for editors:

```yaml
# yaml-language-server: $schema=twinct.schema.json
extends: paper.yaml     # build on another file, relative to this one
trajectory: {views: 100}
```

`extends` merges mappings key by key and replaces everything else; a section whose `kind` changes
starts afresh. A new `algorithm` inherits the keys that it shares with the previous one, such as the
number of iterations; the other inherited keys are dropped with a note in the log. Keys of another
algorithm that you set together with the algorithm, or later, are refused. `--set KEY=VALUE` on the
command line overrides a key: `--set specimen.parts.0.material=water`. Unknown keys are refused.
Lengths are in mm and angles in degrees, as the name of each key says. A `path` is relative to the
file that names it.

Files use a plain subset of YAML 1.2: mappings, lists, texts, numbers, `true`, `false` and `null`.
`no`, `2020-01-01`, `1:30` and `1_000` are texts. Anchors, aliases, tags, merge keys and repeated
keys are refused, and so are files of more than 1 MB, 20 levels or 100,000 values. A length is
between 1e-6 and 1e6 mm. A scenario that does not fit into the memory, or a body that cannot be
built, is refused before work starts; the message names the key.

The column *source* says where a default or a definition comes from: "the paper" is that of Freiling
et al. ([how we read it](paper.md)); an empty cell means that the value is our choice. The pictures
show the built-in skull without and with the effect of a key, and the difference
([more about each](physics.md)).
"""

ANEW = """## What a changed key computes again

Each stage has a digest of the keys that it reads (unless they have their default), of the content
of its files, and of the stages before it. A result is reused as long as this digest stays the same.
The name, the description and the names of the parts never count. `seed` counts for a stage that
draws random numbers: images with noise or random bad pixels, a volume with the views in random
order, executed poses with errors, and believed poses with noise unless `uncertainty.seed` is set.
`uncertainty.seed` changes only the believed poses, and a volume that is made from them.
"""

EXTENSIONS = """## Extensions of your own

Your package can add algorithms, trajectories, objectives of a plan, figures, error terms, X-ray
engines and export formats. The package names them as entry points. Once it is installed
(`pip install .` in its folder), the command line, the ROS 2 nodes and Python all know them:

```toml
[project.entry-points."twinct.algorithms"]
landweber = "my_package.landweber:LANDWEBER"
[project.entry-points."twinct.trajectories"]
zigzag = "my_package.zigzag:ZIGZAG"
[project.entry-points."twinct.objectives"]
level = "my_package.level:LEVEL"
[project.entry-points."twinct.figures"]
tails = "my_package.tails:TAILS"
[project.entry-points."twinct.xray_engines"]
analytic = "my_package.analytic:ANALYTIC"
[project.entry-points."twinct.errors"]
sag = "my_package.sag:SAG"
[project.entry-points."twinct.exports"]
mine = "my_package.mine:MINE"
```

A trajectory, for example, is its keys, a function, and a `Family`:

```python
from typing import Literal

import numpy as np
from pydantic import Field

from twinct.geometry import Panel, ScanGeometry
from twinct.trajectory import Family, OrbitSettings, on_sphere, orbit_views, stops


class Zigzag(OrbitSettings):
    \"\"\"An arc whose views lie above and below it in turn.\"\"\"

    kind: Literal["zigzag"]
    range_deg: float = Field(default=20.0, gt=0, le=360, description="Arc of longitude.")
    latitude_deg: float = Field(default=2.0, ge=0, lt=90, description="Above and below.")


def views(section: Zigzag, panel: Panel) -> ScanGeometry:
    longitude = section.centre_longitude_deg + section.range_deg * (stops(section.views) - 0.5)
    latitude = section.latitude_deg * (-1.0) ** np.arange(section.views)
    path = on_sphere(np.radians(longitude), np.radians(latitude), section.sod_mm)
    return orbit_views(section, panel, path)


ZIGZAG = Family(Zigzag, views)
```

`OrbitSettings` has the keys that all orbits share; `TrajectorySettings` has none. The name of an
entry point is the name in a scenario: the value of `kind`, `algorithm` or `xray.engine`, a key of
`task` or `evaluation`, or the value of `--to`. The other kinds:

- [an algorithm](howto/own_algorithm.md#choose-it-by-name-in-a-scenario): settings, a function, an
  `Algorithm`
- [an objective of a plan](howto/own_objective.md): keys, a measure, an `Objective`
- [a kind of figures](howto/own_figure.md): settings, a formula, a `FigureKind`
- [an X-ray engine](howto/own_engine.md): a class, an `EngineChoice`
- [an export format](howto/own_format.md): a function, a script, a `Format`

Algorithms, trajectories, objectives and figures must not import `twinct.scenario`, which is built
from them. In any section, a key `path`, `file` or `plan` names an input file: the path is made
absolute, the file must exist, and its content counts for the digests. An entry point that fails, or
whose name is taken, is reported with its package, and only scenarios that name it are refused.
`tests/extension` is a complete example of such a package.
"""

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
        "scatter": "`scatter: {kind: kernel}`.",
    },
    "reconstruction": {
        "beam-hardening": "`beam_hardening: null`, `{kind: one_material, material: bone}` and "
        "`{kind: two_materials}`: a small head, less the truth at the mean energy, 1/cm.",
    },
}
"""Captions by section and by name of the picture in ``tools/gallery.py``."""


def reference() -> str:
    """Return the whole page."""
    sections: list[str] = [HEAD]
    seen: set[type[BaseModel]] = set()
    _write(Scenario, "Scenario", sections, seen)
    return "\n".join([*sections, ANEW, _stages(), EXTENSIONS])


def _stages() -> str:
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
    return "" if title == "Scenario" else title.split(" (")[0] + "."


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
        text = f"list of {_type(args[0], [])}" if many else f"{len(args)} numbers"
    elif args and origin is not dict:
        text = " or ".join(dict.fromkeys(_type(arg, []) for arg in args if arg is not type(None)))
    elif origin is dict:
        text = "mapping of names to numbers"
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        text = "section"
    else:
        names = {"str": "text", "float": "number", "int": "whole number", "bool": "true or false"}
        name = getattr(annotation, "__name__", str(annotation))
        text = names.get(name, name.lower())
    return text + _bounds(metadata)


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


if __name__ == "__main__":
    PAGE.write_text(reference(), encoding="utf-8")
    sys.stdout.write(f"wrote {PAGE.name}\n")
