"""Pose errors by their names: tiles, closing line and comparison say which poses they compare."""

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

import twinct.report.page
from twinct.cli.summary import say_result
from twinct.report import Compared, Comparison, render_report
from twinct.report.pose_words import named_pose_errors
from twinct.report.style import Picture

DOT = Picture(b"<svg></svg>", "image/svg+xml")
BOTH = "executed against commanded", "believed against executed"


def errors(size):
    one = {"mean": size, "std": 0.0, "max": size}
    return {arm: {"position_mm": one, "rotation_deg": one} for arm in ("source", "detector")}


@pytest.fixture
def believed(report):
    """Metrics of a run whose believed poses are worse than its motion."""
    geometries = {"believed": {"pose_error": errors(1.23), "made_by": {"model": "encoders"}}}
    metrics = {**report.metrics, "pose_error": errors(0.87), "geometries": geometries}
    return replace(report, metrics=metrics)


def words_of(html):
    return " ".join(re.sub(r"<[^>]+>", " ", html).split())


def tiles(report, monkeypatch):
    names = ("room", "path", "errors", "slices", "convergence", "projections")
    monkeypatch.setattr(twinct.report.page, "draw_pictures", lambda _: dict.fromkeys(names, DOT))
    page = render_report(report)
    return words_of(page.partition('class="cards"')[2].partition("</section>")[0])


def test_tiles_show_both_errors_by_their_names(believed, monkeypatch):
    shown = tiles(believed, monkeypatch)
    for arm in ("source", "detector"):
        assert f"0.87 mm executed against commanded, {arm}: mean distance" in shown
        assert f"1.23 mm believed against executed, {arm}: mean distance" in shown
    assert "position error" not in shown


def test_scans_of_real_arms_show_only_what_was_measured(believed, monkeypatch):
    drive = {"lag_ms": 1.0, "latency_ms": 2.0}
    driven = replace(believed, metrics={**believed.metrics, "drive": drive})
    shown = tiles(driven, monkeypatch)
    assert "0.87 mm measured against planned, source" in shown
    assert not [name for name in BOTH if name in shown] and "1.23" not in shown


def test_runs_of_before_have_one_error():
    assert list(named_pose_errors({"pose_error": errors(1.0)})) == [BOTH[0]]


def test_the_closing_line_names_both(believed, monkeypatch):
    said = []
    monkeypatch.setattr("twinct.cli.summary.say", said.append)
    figures = {**believed.metrics, "reference_material": "bone"}
    finished: Any = SimpleNamespace(figures=figures, paths=SimpleNamespace(report="r.html"))
    say_result(finished)
    (text,) = said
    assert "executed against commanded 0.87 mm source, 0.87 mm detector" in text
    assert "believed against executed 1.23 mm source, 1.23 mm detector" in text
    assert "pose error" not in text


def test_a_comparison_names_both_and_the_geometry_that_was_used(believed, monkeypatch):
    geometries = {**believed.metrics["geometries"], "mine": {"pose_error": errors(0.05)}}
    metrics = {**believed.metrics, "geometries": geometries}
    section = believed.scenario.reconstruction.model_copy(update={"geometry": "mine"})
    scenario = believed.scenario.model_copy(update={"reconstruction": section})
    common = Compared(
        "a",
        "",
        believed.scenario,
        metrics,
        metrics["image"],
        "",
        metrics["seconds"],
        {},
        0.05,
        "bone",
        "a skull",
    )
    rows = Comparison((common, replace(common, label="b", scenario=scenario))).tables()
    found = {(row.meaning, row.title): row.cells for row in rows["Pose errors"]}
    title = "source, position, mean"
    assert [text for text, _ in found[BOTH[0], title]] == ["0.870"] * 2
    assert [text for text, _ in found[BOTH[1], title]] == ["1.230"] * 2
    assert [text for text, _ in found["mine against executed", title]] == ["\N{EN DASH}", "0.050"]
