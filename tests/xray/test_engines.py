"""Engines by name: what is refused, and other engines beside gVXR."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from xray_scenes import body, random_pose, random_view, specimen

from twinct.core.errors import InputError, TwinctError
from twinct.core.extensions import Registry
from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.runs import require_extras
from twinct.scenario import Detector, Source, Specimen, Xray, load_scenario
from twinct.specimen import build_specimen
from twinct.specimen.materials import material
from twinct.xray import Imager, engines
from twinct.xray.engine import EngineChoice, SceneBody
from twinct.xray.gvxr import GVXR
from twinct.xray.paths import PathRenderer

HERE = Path(__file__).parent
DEMO = HERE.parents[1] / "scenarios" / "demo.yaml"
PANEL = Panel(60, 80, 3.0, 2.5)
MU = 0.02
DEPTH_MM = 0.02
"""Largest mean difference of path lengths; gVXR interpolates depths inside a triangle."""
SAME_MEAN, SAME_PIXEL = 1e-4, 5e-3
"""Differences of a transmission: grey values of 16 bits, and gVXR's single precision at a rim."""
MIRRORED_MM = 1.0
"""Least mean difference of path lengths in a mirrored image."""


def wedge() -> trimesh.Trimesh:
    """A tetrahedron that no mirror and no rotation maps to itself."""
    corners = [[-40, -25, -30], [45, -20, -22], [-8, 38, -26], [5, 12, 44]]
    return trimesh.Trimesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@pytest.fixture
def analytic(monkeypatch: pytest.MonkeyPatch) -> str:
    """Name of the engine of ``tests/extension``, known to this process."""
    monkeypatch.syspath_prepend(HERE.parent / "extension")
    from twinct_tiny.analytic import ANALYTIC

    monkeypatch.setitem(engines.BUILT_IN, ANALYTIC.name, ANALYTIC)
    return ANALYTIC.name


def compared(mine: np.ndarray, theirs: np.ndarray) -> tuple[float, float]:
    """Mean difference of path lengths, mm, over the shadow: as they are, and mirrored least."""
    shade = (mine > 0) | (theirs > 0)
    assert 0.02 < shade.mean() < 0.9
    mirrored = [np.abs(other - theirs).mean() for other in (mine[::-1], mine[:, ::-1])]
    return float(np.abs(mine - theirs)[shade].mean()), float(min(mirrored))


@pytest.mark.parametrize("other", ["analytic", "mesh"])
def test_path_lengths_of_two_engines_agree(analytic: str, other: str, figure) -> None:
    bodies = [body(wedge(), material("bone")), body(wedge(), material("titanium"))]
    rng = np.random.default_rng(8)
    views = [random_view(rng, PANEL, np.zeros(3)) for _ in range(5)]
    poses = [[random_pose(rng, 20), random_pose(rng, 20)] for _ in views]
    found = []
    for name in (other, "gvxr"):
        with PathRenderer(bodies, PANEL, 2, 5.0, engine=name) as renderer:
            found.append([renderer.render(*taken) for taken in zip(views, poses, strict=True)])
    pairs = np.array(found).swapaxes(0, 1).reshape(5, 2, 2, *PANEL.divided(2).shape)
    each = [compared(*one) for pair in pairs for one in pair.swapaxes(0, 1)]
    errors, mirrored = zip(*each, strict=True)
    figure(f"{other}, path lengths: worst mean difference {max(errors):.4f} mm")
    assert max(errors) < DEPTH_MM and min(mirrored) > MIRRORED_MM


@pytest.mark.parametrize("other", ["analytic", "mesh"])
def test_images_of_two_engines_agree(analytic: str, other: str, figure) -> None:
    detector = Detector(columns=PANEL.columns, rows=PANEL.rows, pixel_pitch_mm=(3.0, 2.5))
    rng = np.random.default_rng(9)
    views = [random_view(rng, detector.panel, np.zeros(3)) for _ in range(5)]
    poses = [random_pose(rng, 10) for _ in views]
    found = []
    for name in (other, "gvxr"):
        with Imager(Source(), detector, specimen((wedge(), MU)), engine=name) as imager:
            images = [imager.render(view, pose) for view, pose in zip(views, poses, strict=True)]
        found.append(-np.log(images) / MU)
    errors, mirrored = zip(*map(compared, *found), strict=True)
    figure(f"{other}, images: worst mean difference {max(errors):.4f} mm of path")
    assert max(errors) < DEPTH_MM and min(mirrored) > MIRRORED_MM


def test_all_engines_share_one_scene(analytic: str) -> None:
    bodies = [body(wedge(), material("bone"))]
    with PathRenderer(bodies, PANEL, engine=analytic):
        with pytest.raises(TwinctError, match="another X-ray imager is still open"):
            PathRenderer(bodies, PANEL)
    PathRenderer(bodies, PANEL).close()


def test_the_default_is_known_without_looking_for_others(monkeypatch) -> None:
    monkeypatch.setattr(engines, "engines", lambda: pytest.fail("looks for entry points"))
    assert engines.engine_named(Xray().engine) is GVXR


class Idle:
    """Does nothing."""

    def prepare(self) -> None: ...
    def acquire(self, bodies: list[SceneBody], panel: Panel) -> None: ...
    def render(self, view: ScanGeometry, image: np.ndarray) -> None: ...
    def path_lengths(self, view: ScanGeometry, body: int, lengths: np.ndarray) -> None: ...
    def release(self) -> None: ...


def offering(monkeypatch: pytest.MonkeyPatch, choice: EngineChoice) -> None:
    known = Registry("twinct.none", EngineChoice, {"gvxr": GVXR, choice.name: choice})
    known.broken["dark"] = "'dark' of night 1.0 cannot be used"
    monkeypatch.setattr(engines, "engines", lambda: known)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gvrx", "there is no engine 'gvrx'; did you mean 'gvxr'? (allowed: gvxr, idle)"),
        ("dark", "'dark' of night 1.0 cannot be used (allowed: gvxr, idle)"),
        (
            "idle",
            "the engine 'idle' needs nowhere_to_be, os.no, not installed here "
            "(allowed without: gvxr, mesh)",
        ),
    ],
)
def test_an_engine_that_cannot_be_used_is_named(monkeypatch, name: str, message: str) -> None:
    modules = ("numpy", "nowhere_to_be", "os.no")
    offering(monkeypatch, EngineChoice("idle", Idle(), modules=modules))
    with pytest.raises(InputError) as caught:
        require_extras(load_scenario(DEMO, {"xray.engine": name}))
    assert str(caught.value) == f"xray.engine: {message}"


def test_another_engine_needs_no_gvxr(monkeypatch) -> None:
    monkeypatch.setattr("twinct.core.extras._FOUND", {"xray": ("gvxr_that_is_not_there",)})
    offering(monkeypatch, EngineChoice("idle", Idle()))
    with pytest.raises(InputError, match=r"gvxr_that_is_not_there.*--set xray\.engine=mesh"):
        require_extras(load_scenario(DEMO))
    for other in ("idle", "mesh"):
        require_extras(load_scenario(DEMO, {"xray.engine": other}))


def test_a_detector_takes_the_path_lengths_of_any_engine_alike(figure) -> None:
    """Spectrum, focal spot, samples, spread, scatter and noise behind both of our engines."""
    spectrum = {"kind": "tube", "kvp": 90, "bins": 12}
    source = Source.model_validate(
        {"spectrum": spectrum, "focal_spot": {"kind": "square", "size_mm": 1, "samples": 2}}
    )
    detector = Detector.model_validate(
        {
            **{"columns": 80, "rows": 60, "pixel_pitch_mm": 3.0, "pixel_samples": 2},
            **{"point_spread": {"kind": "gaussian", "sigma_mm": 3.0}, "readout": {}},
            **{
                "scatter": {"kind": "monte_carlo", "photons": 20_000, "pixel_mm": 60},
                "noise": {"kind": "snr", "snr": 300},
            },
        }
    )
    parts = {"shape": {"kind": "sphere", "radius_mm": 40}, "material": "bone"}
    pin = {"shape": {"kind": "cylinder", "radius_mm": 4, "height_mm": 90}, "material": "titanium"}
    built = build_specimen(Specimen.model_validate({"parts": [parts, pin]}))
    view = random_view(np.random.default_rng(10), detector.panel, np.zeros(3))
    images = []
    for name in ("mesh", "gvxr"):
        with Imager(source, detector, built, engine=name) as imager:
            images.append(imager.render(view, Pose.identity()))
    error = np.abs(images[0] - images[1])
    figure(f"transmission: mean difference {error.mean():.1e}, largest {error.max():.1e}")
    assert images[0].min() < 0.2 and error.mean() < SAME_MEAN and error.max() < SAME_PIXEL
