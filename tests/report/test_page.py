"""The report: one file, everything in it, nothing taken from elsewhere."""

import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

import twinct.report.page
from twinct.geometry import Panel
from twinct.report import figures, render_report, with_results, write_report
from twinct.report.page import PAPER_TABLE_1

DOT = figures.Picture(b"a dot", "image/png")
VOID = {"meta", "img", "br", "hr", "link", "input"}


class Page(HTMLParser):
    """Checks nesting, and collects texts, images and all addresses."""

    def __init__(self, html):
        super().__init__()
        self.open, self.tags, self.images, self.addresses, self.text = [], [], [], [], []
        self.feed(html)
        self.close()
        assert not self.open, f"never closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "srcset", "data", "poster", "action"):
                self.addresses.append(value)
        if tag == "img":
            self.images.append(dict(attrs))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] != "style":
            self.text.append(data)

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


@pytest.fixture(scope="session")
def html(report):
    return render_report(report)


@pytest.fixture(scope="session")
def page(html):
    return Page(html)


@pytest.fixture
def undrawn(monkeypatch):
    """For what concerns text alone: drawing is what takes the time."""
    names = ("room", "path", "errors", "slices", "convergence", "projections")
    monkeypatch.setattr(twinct.report.page, "draw_pictures", lambda _: dict.fromkeys(names, DOT))


def content(image):
    kind, _, data = image["src"].partition(";base64,")
    return kind, base64.b64decode(data, validate=True)


def test_every_image_is_inside_and_can_be_read(page):
    assert [image["alt"] for image in page.images] == [
        "Path of the source around the isocentre",
        "Cross-sections of reconstruction, truth and error",
        "Residual of each iteration",
        "Pose errors and clearance over the views",
        "Projections",
    ]
    for image in page.images:
        kind, data = content(image)
        if kind == "data:image/svg+xml":
            assert b"</svg>" in data
        else:
            assert kind == "data:image/png"
            pixels = np.asarray(Image.open(io.BytesIO(data)))
            assert pixels.shape[1] > 500 and pixels.std() > 10, "not blank"


def test_nothing_is_loaded_from_elsewhere(page, html):
    assert all(address.startswith("data:") for address in page.addresses)
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    style = re.search(r"<style>(.*?)</style>", html, re.S).group(1)
    assert "url(" not in style and "@import" not in style


def test_scenario_text_is_escaped(report, page, html, undrawn):
    assert "<b>" not in html and "&lt;b&gt;&amp;amp;" in html
    assert report.scenario_yaml.strip() in "".join(page.text), "shown as it was written"
    nasty = report.scenario.model_copy(
        update={"name": "<script>x</script>", "description": "a < b & c"}
    )
    other = Page(render_report(replace(report, scenario=nasty)))
    assert "script" not in other.tags
    assert "<script>x</script>" in other.words and "a < b & c" in other.words


def test_says_the_figures(report, page):
    metrics, words = report.metrics, page.words
    assert "24 / 24" in words
    error = metrics["pose_error"]["detector"]["position_mm"]
    assert f"{error['mean']:.3f} ± {error['std']:.3f} {error['max']:.3f} 0.76 ± 0.07 0.96" in words
    assert "believed geometry executed geometry" in words
    image = metrics["image"]
    lead = f"{100 * image['rmse_near_rel']:.1f} % RMSE near bone; good: below 5 %"
    assert words.index(lead) < words.index("24 / 24"), "the figures near the object lead"
    assert f"{image['ssim_near']:.3f} SSIM near bone; good: above 0.8" in words
    assert words.index("SSIM near bone") < words.index("3-D, windows of 7³ voxels")
    assert "reconstruction 16.0 min" in words and "whole run 18.1 min" in words
    assert metrics["scenario_digest"] in words


def test_the_figures_name_the_material(report, undrawn):
    words = Page(render_report(replace(report, reference="aluminium"))).words
    for told in (
        "RMSE near aluminium; good: below 5 %",
        "of μ(aluminium), within 3 mm of aluminium",
        "mean in aluminium",
        "aluminium in the region",
    ):
        assert told in words
    assert "μ(bone)" not in words and "near bone" not in words


def test_table_1_is_the_papers():
    flat = [
        list(PAPER_TABLE_1[arm][kind].values())
        for arm in ("source", "detector")
        for kind in ("position_mm", "rotation_deg")
    ]
    assert flat == [[0.87, 0.05, 0.98], [0.19, 0.03, 0.23], [0.76, 0.07, 0.96], [0.20, 0.05, 0.41]]


def test_figures_without_a_value_show_a_dash(report, undrawn):
    metrics = dict(report.metrics)
    metrics.pop("image_by_geometry")
    metrics.pop("believed_minus_executed")
    metrics["image"] = metrics["image"] | {"psnr_db": None, "zero": {}}
    page = Page(render_report(replace(report, metrics=metrics)))
    assert "PSNR – dB" in page.words and "believed geometry good meaning" in page.words


def test_figures_of_an_earlier_version_are_missing_and_said_to_be(report, undrawn):
    """The seven figures that the first versions had."""
    first = list(report.metrics["image"])[:7]
    metrics = dict(report.metrics)
    for name in ("image_by_geometry", "believed_minus_executed"):
        metrics.pop(name)
    metrics["image"] = {name: report.metrics["image"][name] for name in first}
    words = Page(render_report(replace(report, metrics=metrics))).words
    assert "– SSIM near bone; good: above 0.8" in words and "signal – %" in words
    assert "– believed geometry: its signal is unknown" in words
    metrics["image"] = report.metrics["image"] | {"signal_rel": 0.0, "ssim": None}
    words = Page(render_report(replace(report, metrics=metrics))).words
    assert "SSIM – " in words and "– believed geometry: the volume has 0.0 %" in words


def test_parts_that_are_not_there_leave_no_gap(report):
    metrics = dict(report.metrics) | {"residuals": {"believed": []}}
    bare = replace(report, slices={}, projections=(), room_png=None, metrics=metrics)
    page = Page(render_report(bare))
    assert len(page.images) == 2
    assert "Projections" not in page.words and "Reconstruction and truth" not in page.words
    with_room = replace(bare, room_png=b"\x89PNG picture")
    room = Page(render_report(with_room)).images[0]
    assert content(room) == ("data:image/png", b"\x89PNG picture")


def test_written_whole_and_the_same_each_time(report, html, tmp_path):
    path = tmp_path / "report.html"
    write_report(path, report)
    assert path.read_text(encoding="utf-8") == html
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert path.stat().st_size < 6e6


def test_region_outline_is_closed_at_the_border(report):
    """A region that reaches the border, one that is empty, one that is all: none may fail."""
    section = report.slices["axial"]
    half = np.zeros_like(section.roi)
    half[:, : half.shape[1] // 2] = True
    pictures = {
        figures.cross_section_grid({"axial": section._replace(roi=roi)}, 0.043).content
        for roi in (half, np.zeros_like(half), np.ones_like(half))
    }
    assert len(pictures) >= 2


def test_path_off_a_sphere_has_no_sphere():
    """A helix, as an ellipse of sources would, stands on no sphere; a circle does."""
    turn = np.linspace(0, 4 * np.pi, 40)
    circle = 300 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    helix = circle + np.outer(np.linspace(-90, 90, 40), [0, 0, 1.0])
    grey = []
    for path in (circle, helix):
        png = figures.source_path(path, path, np.zeros(3)).content
        pixels = np.asarray(Image.open(io.BytesIO(png))).astype(int)
        neutral = np.ptp(pixels, axis=2) < 6
        grey.append((neutral & (pixels[..., 0] > 150) & (pixels[..., 0] < 240)).mean())
    assert grey[0] > 0.1 and grey[1] < 0.02


def test_labels_of_a_full_circle_stand_side_by_side():
    viewer, centre = np.array([1.0, 0, 0]), np.full(3, 5.0)
    near = centre + 300 * np.array([[1.0, 0, 0], [0.999, -0.05, 0]])
    assert figures._sides(near, viewer, centre) == ("left", "right")
    assert figures._sides(near[::-1], viewer, centre) == ("right", "left")
    assert figures._sides(near[[0, 0]], viewer, centre) == ("right", "left")
    apart = centre + 300 * np.array([[1.0, 0, 0], [0, -1.0, 0]])
    assert figures._sides(apart, viewer, centre) == ("center", "center")


@pytest.mark.parametrize("shape", [(100, 100), (150, 120)])
def test_titles_of_projections_do_not_touch_the_edge(shape):
    images = [(view, np.full(shape, 0.1)) for view in range(4)]
    png = figures.projection_strip(images, Panel(shape[0], shape[1], 1.0, 1.0)).content
    assert np.asarray(Image.open(io.BytesIO(png)).convert("L"))[:5].min() == 255


@pytest.mark.parametrize(
    ("value", "expected"), [(0.0123, 0.02), (0.02, 0.02), (0.91, 1.0), (3.0, 3.0), (1e-5, 1e-5)]
)
def test_error_window_is_a_round_number(value, expected):
    assert figures._nice(value) == pytest.approx(expected)


def test_figures_are_named_after_their_material(report, undrawn) -> None:
    text = render_report(replace(report, reference="aluminium"), undrawn)
    assert "RMSE near aluminium" in text and "μ(aluminium)" in text
    assert "near bone" not in text and "μ(bone)" not in text


@pytest.mark.parametrize(
    ("densest", "end"), [(0.5, 1.0), (1.0, 1.0), (1.6, 1.6), (4.0, 2.0)], ids=str
)
def test_metal_is_white_and_leaves_the_rest_grey(report, densest: float, end: float) -> None:
    section, mu = report.slices["axial"], report.mu_reference
    sections = {"axial": section._replace(truth=np.full_like(section.truth, densest * mu))}
    window = figures._grey_window(list(sections.values()), mu)
    assert (window.vmin, window.vmax) == pytest.approx((-0.1 * end * mu, 1.2 * end * mu))


def test_the_nearest_bodies_are_named(report, undrawn) -> None:
    assert "nearest are" not in render_report(report)
    named = replace(report, nearest=("table", "the source arm's forearm"))
    assert "is between table and the source arm&#39;s forearm" in render_report(named)


def test_known_implants_are_told_of_each_reconstruction(report, undrawn) -> None:
    screw = {
        "name": "jaw screw",
        "position_mm": [-31.256, 45, -76],
        "position_sigma_mm": [0.021, 0.02, 0.02],
        "rotation_deg": [88, 0, -25],
        "moved_mm": 1.234,
        "turned_deg": 4.321,
        "density_rel": 0.912,
        "slack_mm": 0.07,
    }
    kept = {"sart-2": {"implants": [screw | {"moved_mm": 1.5}]}}
    metrics = report.metrics | {"implants": [screw], "reconstructions": kept}
    text = render_report(replace(report, metrics=metrics), undrawn)
    table = text[text.index("Known implants") :]
    for part in ("jaw screw", "main reconstruction", "-31.26 (0.02)", "1.23", "4.32", "0.912"):
        assert part in table or part.replace("-", "−") in table, part
    assert table.count("jaw screw") == 2 and "<td>sart-2</td>" in table and "1.50" in table
    assert "Known implants" not in render_report(report, undrawn)


def test_predictions_stand_beside_measurements(report, undrawn) -> None:
    title = "Prediction beside measurement"
    assert title not in render_report(report, undrawn)
    predicted = figures.Picture(b"predicted", "image/png")
    shown = render_report(replace(report, predictions=[("own volume", predicted)]), undrawn)
    assert title in shown and predicted.data_uri in shown and "own volume" in shown
    late_ms = {"mean": 8.004, "std": 0.3, "max": 9.5}
    drive = {"lag_ms": 8.001, "latency_ms": 12.0, "late_ms": late_ms}
    drive |= {"planned_s": 7.25, "taken_s": 7.251}
    shown = render_report(replace(report, metrics={**report.metrics, "drive": drive}), undrawn)
    for value in ("8.00 ms", "8.00 ± 0.30 ms", "9.50 ms", "7.250 s", "7.251 s", "12.00 ms"):
        assert value in shown
    drive = {"lag_ms": None, "latency_ms": 12.0}
    shown = render_report(replace(report, metrics={**report.metrics, "drive": drive}), undrawn)
    assert "12.00 ms" in shown and "planned" not in shown.partition(title)[2].partition("<h2>")[0]


def test_how_fast_the_tools_move_is_said(report, undrawn) -> None:
    speeds = {"source": {"mean": 80.0, "max": 125.2}, "detector": {"mean": 70.0, "max": 90.0}}
    told = replace(report, metrics={**report.metrics, "tool_speed_mm_s": speeds})
    assert "up to 125 mm/s, 0.25 mm in a step" in render_report(told)
    assert "mm/s" not in render_report(report)


def test_a_path_of_few_views_stays_on_its_sphere() -> None:
    from twinct.report.figures import _fine

    corners = 300.0 * np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]])
    path = _fine(corners)
    np.testing.assert_allclose(np.linalg.norm(path, axis=1), 300.0)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() < 300 * 0.03
    assert steps.sum() == pytest.approx(300 * np.pi, rel=1e-3)


def test_warnings_of_a_volume_stand_above_the_figures(report, undrawn):
    metrics = dict(report.metrics) | {"warnings": ["the volume does not explain the projections"]}
    words = Page(render_report(replace(report, metrics=metrics))).words
    warning = "Warning: the volume does not explain the projections."
    assert words.count(warning) == 1
    assert words.index(warning) < words.index("views reached")
    assert "warning: the rest" in with_results("SART", {"warnings": ["the rest"]})
