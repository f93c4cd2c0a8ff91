"""The page of a study: means that are right, nothing claimed that was not tried, small enough."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from twinct.report import figures
from twinct.report.figure_words import figure_words
from twinct.report.repetitions import StudyTrial, combinations, mean_of, trend
from twinct.report.study_page import StudyAxis, StudyData, best_trials, render_study, write_study

RMSE, SSIM = "image.rmse_rel", "image.ssim"
DOUBLE = 1e-12
"""Relative; both compute in double precision."""


def trial(number, axes, seed=None, value=None, **changes):
    own = {"trial": number, "axes": axes, "seed": seed, "done": True}
    own["figures"] = {} if value is None else {RMSE: value}
    return StudyTrial(**own | changes)


def crossed(values, rng=None, seeds=10, **fixed):
    """All combinations of the values of each axis, with seeds; RMSE is 0.1 plus noise."""
    rng = rng or np.random.default_rng(5)
    found = [{}]
    for label, own in values.items():
        found = [one | {label: value} for one in found for value in own]
    pairs = [(axes, seed) for axes in found for seed in range(seeds)]
    return [
        trial(number, axes, seed, 0.1 + 0.01 * rng.standard_normal(), **fixed)
        for number, (axes, seed) in enumerate(pairs)
    ]


def study(trials, *axes, figures=(RMSE,), **changes):
    return StudyData("A study", [StudyAxis(a) for a in axes], figures, trials, "a: 1\n", **changes)


def words_of(html):
    html = re.sub(r"<style>.*?</style>", "", html, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", " ", html).split())


def table_of(html, title):
    """Rows of the first table below a title, cells as text."""
    body = html[html.index(f"<h2>{title}</h2>") :].partition("</table>")[0]
    return [
        [re.sub(r"<[^>]+>", "", cell).strip() for cell in re.findall(r"<t[hd].*?</t[hd]>", row)]
        for row in re.findall(r"<tr>.*?</tr>", body, flags=re.DOTALL)
    ]


@pytest.fixture
def drawn(monkeypatch):
    """Figures as matplotlib has them, in place of their text."""
    seen, svg = [], figures.svg

    def keep(figure):
        seen.append(figure)
        return svg(figure)

    monkeypatch.setattr(figures, "svg", keep)
    return seen


# --- means ---------------------------------------------------------------------------------------


def test_the_interval_is_students():
    # By hand: s = sqrt(5 / 3), t(3; 0.975) = 3.1824 of any printed table.
    mean, half, n = mean_of([1.0, 2.0, None, 3.0, 4.0])
    assert (mean, n) == (2.5, 4) and half == pytest.approx(3.1824 * (5 / 3) ** 0.5 / 2, abs=1e-4)
    values = np.random.default_rng(3).normal(5, 2, 10)
    low, high = stats.t.interval(0.95, 9, values.mean(), stats.sem(values))
    mean, half, _ = mean_of(values)
    assert (mean - half, mean + half) == pytest.approx((low, high), rel=DOUBLE)


def test_one_value_has_no_interval():
    assert mean_of([0.5]) == (0.5, None, 1)
    assert mean_of([None]) == mean_of([]) == (None, None, 0)


def test_combinations_are_told_apart_whatever_their_values_are():
    values = [1, True, "1", None, [1], {"kind": "fdk"}, 1.5]
    trials = [trial(k, {"axis": v}, k) for k, v in enumerate(values * 2)]
    found = combinations(trials[::-1], ["axis"])
    assert [one.values[0] for one in found] == values
    assert [[t.trial for t in one.trials] for one in found] == [[k, k + 7] for k in range(7)]


def test_one_line_for_each_combination_of_the_others():
    trials = crossed({"noise": [0.3, 0, 0.1], "iterations": [3, 10]})
    shown = trend(combinations(trials, ["noise", "iterations"]), 0, RMSE)
    assert shown.values == [0, 0.1, 0.3] and not shown.averaged and not shown.cloud
    assert [told for told, _ in shown.lines] == [(3,), (10,)]
    for (iterations,), line in shown.lines:
        assert [x for x, _ in line] == [0, 0.1, 0.3]
        for x, mean in line:
            own = [
                t.figures[RMSE] for t in trials if t.axes == {"noise": x, "iterations": iterations}
            ]
            low, high = stats.t.interval(0.95, 9, np.mean(own), stats.sem(own))
            assert (mean.mean - mean.half, mean.mean + mean.half) == pytest.approx(
                (low, high), rel=DOUBLE
            )


def test_more_are_averaged_and_only_seeds_tell_the_interval():
    """Combinations differ by 1 from each other, seeds by 0.01: the interval must not see the 1."""
    rng = np.random.default_rng(8)
    by_seed = 0.01 * rng.standard_normal(10)
    trials = [
        replace(t, figures={RMSE: t.axes["other"] + by_seed[t.seed]})
        for t in crossed({"axis": ["a", "b"], "other": list(range(7))})
    ]
    # Seed 3 has failed once: it counts nowhere at "a", or its average would be of others.
    trials[3] = replace(trials[3], done=False, figures={})
    found = combinations(trials, ["axis", "other"])
    shown = trend(found, 0, RMSE)
    assert shown.averaged and [told for told, _ in shown.lines] == [()]
    (_, a), (_, b) = shown.lines[0][1]
    assert (a.n, b.n) == (9, 10)
    for mean, own in ((a, np.delete(by_seed, 3)), (b, by_seed)):
        assert mean.mean == pytest.approx(3 + own.mean(), rel=DOUBLE)
        half = stats.t.ppf(0.975, len(own) - 1) * stats.sem(own)
        assert mean.half == pytest.approx(half, rel=1e-9), "differences of numbers about 3"
    assert len(shown.cloud) == 14
    assert not trend(found, 1, RMSE).averaged, "two lines"


def test_where_no_seed_is_in_all_there_is_an_average_without_interval():
    trials = [trial(k, {"axis": 0, "other": k}, seed=k, value=float(k)) for k in range(8)]
    trials += [trial(8, {"axis": 1, "other": 0}, seed=0, value=1.0)]
    shown = trend(combinations(trials, ["axis", "other"]), 0, RMSE)
    assert shown.lines[0][1][0] == (0, (3.5, None, 0))


def test_an_axis_that_does_not_apply_leaves_a_combination_out():
    trials = [trial(k, {"axis": v}, None, 1.0) for k, v in enumerate([None, 1, 2])]
    shown = trend(combinations(trials, ["axis"]), 0, RMSE)
    assert (shown.values, shown.left_out, shown.had) == ([1, 2], 1, 2)


def test_what_varies_along_with_an_axis_makes_no_lines():
    """Paired axes, one that has a single value, and one that is valid for one algorithm only."""
    told = [("sart", n, c, i, "x") for n, c in ((0, 0), (1, 2), (3, 7)) for i in (3, 10)]
    told += [("fdk", n, c, None, "x") for n, c in ((0, 0), (1, 2), (3, 7))]
    labels = ["algorithm", "noise", "cut-off", "iterations", "same"]
    trials = [trial(k, dict(zip(labels, v, strict=True)), None, 0.1) for k, v in enumerate(told)]
    found = combinations(trials, labels)
    noise, iterations = trend(found, 1, RMSE), trend(found, 3, RMSE)
    assert (noise.others, noise.along, noise.joined) == ([0, 3], [2], True)
    assert [told for told, _ in noise.lines] == [("sart", 3), ("sart", 10), ("fdk", None)]
    assert (iterations.others, iterations.along, iterations.left_out) == ([1, 2], [], 3)
    # One draw of all axes each, as a search asks for them: nothing lies between two of them.
    drawn = [trial(k, {"a": k, "b": (7 * k) % 10}, None, 0.1) for k in range(10)]
    assert not trend(combinations(drawn, ["a", "b"]), 0, RMSE).joined
    again = [*drawn, *(replace(one, trial=one.trial + 10) for one in drawn)]
    assert trend(combinations(again, ["a", "b"]), 0, RMSE).joined


# --- words ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "label", "best"),
    [
        ("image.rmse_near_rel", "RMSE near steel / %", "lower"),
        ("image_by_geometry.executed.ssim", "SSIM, executed geometry", "higher"),
        ("image.psnr_db", "PSNR / dB", "higher"),
        ("image.mean_reference_rel", "mean in steel / %", "one"),
        (
            "pose_error.source.position_mm.max",
            "executed against commanded, source, position, largest / mm",
            "lower",
        ),
        (
            "geometries.believed.pose_error.detector.rotation_deg.mean",
            "believed against executed, detector, rotation, mean / deg",
            "lower",
        ),
        ("clearance_mm.min", "clearance, smallest / mm", "higher"),
        ("seconds.xray", "time: X-ray projections / s", "lower"),
        ("tool_speed_mm_s.source.max", "tool speed, source, largest / mm/s", ""),
        ("views", "views", ""),
        ("image.edge_width_mm", "edge width / mm", "lower"),
        ("image.zero.ssim", "SSIM, empty volume", ""),
        ("image.rmse_rel_by_depth.5_to_10_mm", "RMSE, 5 to 10 mm deep / %", "lower"),
        ("image.contrasts.a_against_b.cnr", "contrast to noise, a against b", "higher"),
        (
            "image_by_geometry.executed.nps.brain.noise_rel",
            "noise, brain, executed geometry / %",
            "lower",
        ),
        ("believed_minus_executed.rmse_rel", "RMSE, believed minus executed / %", ""),
    ],
)
def test_figures_have_words(name, label, best):
    shown = figure_words(name, "steel")
    assert (shown.label, shown.best) == (label, best)


# --- the best ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("figure", "best", "expected"),
    [
        (RMSE, "", [1, 2, 5]),
        (RMSE, "higher", [4, 3, 0]),
        (SSIM, "", [4, 3, 0]),
        ("image.mean_reference_rel", "", [2, 0, 5]),
        ("views", "", []),
    ],
)
def test_the_best_repetition_of_the_best_combinations(figure, best, expected):
    values = [(0, 0.9), (0, 0.5), (1, 0.95), (1, 1.2), (2, 1.5), (2, 1.45)]
    trials = [
        trial(k, {"axis": axis}, k, figures={figure: value})
        for k, (axis, value) in enumerate(values)
    ]
    trials += [trial(9, {"axis": 3}, 0, done=False, figures={figure: 0.0})]
    assert best_trials(study(trials, "axis", figures=[figure], best=best)) == expected


# --- pictures ------------------------------------------------------------------------------------


def test_bars_are_the_intervals_and_axes_what_they_were_told(drawn):
    trials = crossed({"noise": [0.0, 0.1, 0.3], "current": [1.0, 10.0], "kind": ["a", "b"]})
    axes = [StudyAxis("noise", "mm", log=True), StudyAxis("current", log=True), StudyAxis("kind")]
    html = render_study(replace(study(trials), axes=axes))
    noise, current, kind = (figure.axes[0] for figure in drawn)
    scales = [axes.get_xscale() for axes in (noise, current, kind)]
    assert scales == ["symlog", "log", "linear"], "0 is on no logarithmic axis"
    assert noise.get_xlabel() == "noise / mm" and noise.get_ylabel() == "RMSE / %"
    assert [len(axes.containers) for axes in (noise, current, kind)] == [4, 6, 6]
    line, _, (bars,) = noise.containers[0].lines
    own = [t.figures[RMSE] for t in trials if t.axes == trials[0].axes]
    low, high = stats.t.interval(0.95, 9, np.mean(own), stats.sem(own))
    np.testing.assert_allclose(bars.get_segments()[0][:, 1], [100 * low, 100 * high], rtol=1e-9)
    assert line.get_linestyle() == "-"
    assert kind.containers[0].lines[0].get_linestyle() == "None", "names are not joined"
    assert [text.get_text() for text in kind.get_xticklabels()] == ["a", "b"]
    legend = [text.get_text() for text in drawn[0].legends[0].get_texts()]
    assert legend == ["1, a", "1, b", "10, a", "10, b"]
    assert html.count('src="data:image/svg') == 3


def test_averages_say_so_and_show_what_they_are_of(drawn):
    html = render_study(study(crossed({"a": [1, 2], "b": list(range(4)), "c": [1, 2]}), *"abc"))
    said = words_of(html)
    assert (
        "RMSE over a; averaged over the combinations of b, c; dots: the single combinations" in said
    )
    assert "RMSE over b." in said, "four lines"
    dots, average = drawn[0].axes[0].lines[:2]
    assert len(dots.get_xdata()) == 16 and len(average.get_xdata()) == 2


# --- the page ------------------------------------------------------------------------------------


def test_the_table_has_each_combination_with_mean_interval_and_n():
    trials = crossed({"noise": [0, 0.25], "algorithm": ["sart", None]}, seeds=3)
    trials[0] = replace(trials[0], figures={RMSE: None}, report='trials/0 "a"/report.html')
    trials[3] = replace(trials[3], done=False, message="no <b>way</b>", figures={})
    html = render_study(study(trials, "noise", "algorithm"))
    head, *rows = table_of(html, "Combinations")
    assert head == ["noise", "algorithm", "RMSE / %", "± 95 %", "n", "failed", "reports"]
    assert [row[:2] for row in rows] == [["0", "sart"], ["0", "–"], ["0.25", "sart"], ["0.25", "–"]]
    assert [row[4:] for row in rows] == [
        ["2", "", "0"],
        ["2", "1", ""],
        ["3", "", ""],
        ["3", "", ""],
    ]
    own = [t.figures[RMSE] for t in trials[6:9]]
    half = stats.t.ppf(0.975, 2) * stats.sem(own)
    assert [float(cell) for cell in rows[2][2:4]] == pytest.approx(
        [100 * np.mean(own), 100 * half], abs=0.05
    )
    assert 'href="trials/0%20%22a%22/report.html"' in html
    assert "no &lt;b&gt;way&lt;/b&gt;" in html and "<script" not in html


def test_digits_show_two_places_of_a_small_interval():
    trials = [trial(k, {}, k, 0.1 + 1e-4 * k) for k in range(3)]
    _, row = table_of(render_study(study(trials)), "Combinations")
    assert row == ["10.010", "0.025", "3"]


def test_failures_are_grouped_by_message():
    messages = [*["out of reach"] * 5, *["<worker> died"] * 2, "out of reach", "odd"]
    trials = [
        trial(k, {"a": k}, done=False, message=message, kind="TrajectoryError")
        for k, message in enumerate(messages)
    ]
    html = render_study(study([*trials, trial(20, {"a": 20}, None, 0.1)], "a"))
    _, *rows = table_of(html, "Failures")
    assert rows == [
        ["6", "out of reach", "TrajectoryError", "0 to 4, 7"],
        ["2", "&lt;worker&gt; died", "TrajectoryError", "5 to 6"],
        ["1", "odd", "TrajectoryError", "8"],
    ]


def test_a_study_of_one_trial_claims_no_interval():
    one = trial(0, {"a": 1}, None, 0.125, seconds={"xray": 2.0, "total": 3.0})
    html = render_study(study([one], "a", planned=4, wall_seconds=5.0))
    said = words_of(html)
    assert "No combination was repeated, so there are no intervals." in said
    assert "1 / 4 trials done" in said and "5.0 s from start to end" in said
    assert table_of(html, "Combinations")[1] == ["1", "12.5", "–", "1"]
    assert table_of(html, "Time")[1:] == [
        ["X-ray projections", "2.0 s", "2.0 s", "1"],
        ["whole run", "3.0 s", "3.0 s", "1"],
    ]
    assert "src=" not in html and "Failures" not in html


@pytest.mark.parametrize("axes", [("a",), ()])
def test_all_failed_or_none_begun(axes):
    failed = [trial(k, {"a": k}, done=False, message="no") for k in range(3)]
    said = words_of(render_study(study(failed, *axes)))
    assert "3 failed" in said and "No trial has RMSE." in said and "3 no 0 to 2" in said
    assert "No trial has ended." in words_of(render_study(study([], *axes)))
    assert "3 failed" in words_of(render_study(study(failed, *axes, figures=())))


def test_ten_thousand_trials_stay_a_small_page(drawn):
    rng = np.random.default_rng(2)
    axes = rng.uniform(size=(10_000, 2))
    trials = [
        trial(k, {"x": x, "y": y, "n": k % 30}, None, y, done=k % 100 > 0, message=f"view {k}")
        for k, (x, y) in enumerate(axes.tolist())
    ]
    html = render_study(study(trials, "x", "y", "n"))
    assert len(html) < 0.5e6, "bytes; 2 MB for 12 pictures"
    assert len(drawn) == 3 and all(len(f.axes[0].lines[0].get_xdata()) <= 1000 for f in drawn)
    said = words_of(html)
    assert "The 200 best of 10000 combinations, by RMSE; all rows are in results.parquet" in said
    _, *rows = table_of(html, "Combinations")
    best = sorted(t.figures[RMSE] for t in trials if t.done)[:200]
    assert [float(row[1]) for row in rows] == pytest.approx(best, abs=1e-6)
    assert "RMSE over x; y, n vary with it; dots: 990 of 9900 single combinations" in said


def test_best_trials_are_shown_beside_the_truth(report, monkeypatch):
    shown = []

    def side_by_side(columns, truth, looks, dpi):
        shown.append((list(columns), looks))
        return figures.Picture(b"picture", "image/png")

    monkeypatch.setattr("twinct.report.figures.side_by_side", side_by_side)
    trials = [trial(k, {"a": k}, None, 1.0 - 0.1 * k) for k in range(9)]
    data = study(trials, "a")
    best = best_trials(data)
    assert best == [8, 7, 6, 5, 4, 3]
    planes = {name: report.slices[name] for name in ("axial", "coronal")}
    whole = replace(data, sections=dict.fromkeys(range(9), planes))
    html = render_study(whole)
    assert [names for names, _ in shown] == [[f"trial {k}" for k in best]] * 2
    assert shown[0][1] is shown[1][1], "the same windows"
    assert "The truth shown is that of" not in html and html.count('src="data:image/png') == 2
    other = planes["axial"]._replace(truth=2 * planes["axial"].truth)
    html = render_study(
        replace(whole, sections={8: planes, 3: planes | {"axial": other}, 99: planes})
    )
    assert shown[-1][0] == ["trial 8", "trial 3"]
    assert "The truth shown is that of trial 8" in html


def test_pictures_of_the_best_are_drawn(report):
    data = study([trial(0, {}, None, 0.1)], sections={0: {"axial": report.slices["axial"]}})
    assert render_study(data).count('src="data:image/png') == 1


def test_the_file_is_there_when_it_is_complete(tmp_path):
    write_study(tmp_path / "study.html", study([]))
    assert [path.name for path in tmp_path.iterdir()] == ["study.html"]
    assert "a: 1" in (tmp_path / "study.html").read_text(encoding="utf-8")
