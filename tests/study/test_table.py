"""Means, paired differences and pictures of a study's table."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from twinct.core.errors import InputError
from twinct.study.journal import Row
from twinct.study.notebook import study_in_notebook
from twinct.study.results import load_results, results_table, write_results

pytest.importorskip("pandas")
SEEDS, FIGURE = 6, "image.rmse_rel"


def rows() -> list[Row]:
    """Two paths with two numbers of views; all share the noise of a seed, larger than effects."""
    noise = np.random.default_rng(1).normal(0, 0.1, SEEDS)
    own = np.random.default_rng(2).normal(0, 0.001, (4, SEEDS))
    return [
        Row(
            trial=SEEDS * place + seed,
            key=f"{place}{seed}",
            axes={"path": path, "views": views},
            seed=seed,
            status="done",
            figures={FIGURE: 0.3 + 0.01 * place + float(noise[seed] + own[place, seed])},
            seconds={"xray": 1.0},
        )
        for place, (path, views) in enumerate(
            (path, views) for path in ("circle", "saddle") for views in (20, 40)
        )
        for seed in range(SEEDS)
    ]


def test_a_summary_has_means_and_paired_differences_of_the_seeds():
    table = results_table(rows())
    found = table.summary(FIGURE)
    assert list(found["path"]) == ["circle", "circle", "saddle", "saddle"]
    assert list(found["views"]) == [20, 40, 20, 40]
    for place in range(4):
        mine = table[FIGURE].to_numpy()[SEEDS * place : SEEDS * (place + 1)]
        line = found.iloc[place]
        low, high = stats.t.interval(0.95, SEEDS - 1, mine.mean(), stats.sem(mine))
        assert line["mean"] == pytest.approx(mine.mean())
        assert line["interval"] == pytest.approx((high - low) / 2)
        assert line["trials"] == SEEDS
    apart = table[FIGURE].to_numpy()[3 * SEEDS :] - table[FIGURE].to_numpy()[:SEEDS]
    last = found.iloc[3]
    assert last["difference"] == pytest.approx(apart.mean())
    assert last["difference_interval"] < last["interval"] / 20, "shared noise drops out"
    assert last["pairs"] == SEEDS and found.iloc[0]["pairs"] == 0


def test_a_summary_compares_with_the_combination_that_is_named():
    found = results_table(rows()).summary(FIGURE, against={"path": "saddle", "views": 20})
    assert found.iloc[2]["pairs"] == 0
    assert found.iloc[0]["difference"] == pytest.approx(-0.02, abs=0.002)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"figures": ("image.rmse",)}, "'image.rmse' is no figure of this study; it has image"),
        ({"against": {"path": "spiral"}}, "0 combinations have path = spiral; name one by values"),
        ({"against": {"path": "circle"}}, "2 combinations have path = circle; name one by values"),
    ],
)  # fmt: skip
def test_what_the_study_does_not_have_is_named(arguments, said):
    with pytest.raises(InputError, match=said):
        results_table(rows()).summary(*arguments.pop("figures", ()), **arguments)


def test_an_empty_table_says_so():
    with pytest.raises(InputError, match="no results yet"):
        results_table([]).summary()


@pytest.mark.parametrize("ending", ["png", "pdf"])
def test_a_picture_is_written_as_png_and_pdf(tmp_path, ending):
    path = tmp_path / f"picture.{ending}"
    results_table(rows()).plot(FIGURE, over="views", path=path)
    assert path.read_bytes()[:4] in (b"\x89PNG", b"%PDF")


def test_a_picture_needs_an_axis_that_varies_and_a_figure(tmp_path):
    table = results_table(rows())
    with pytest.raises(InputError, match="over is 'seed'; .* varies over path, views"):
        table.plot(FIGURE, over="seed", path=tmp_path / "x.png")
    with pytest.raises(InputError, match="no figure of this study"):
        table.plot("image.none", path=tmp_path / "x.png")


def test_pandas_own_plots_still_work():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    _, axes = pyplot.subplots()
    results_table(rows()).plot(x="trial", y=FIGURE, backend="matplotlib", ax=axes)
    pyplot.close("all")
    assert axes.get_xlabel() == "trial"


def test_a_table_that_was_read_again_and_a_part_of_it_know_their_axes(tmp_path):
    from twinct.study.journal import Journal

    Journal(tmp_path).append(rows())
    write_results(tmp_path, rows())
    table = load_results(tmp_path)
    assert len(table[table.seed < 3].summary(FIGURE)) == 4


def test_a_notebook_shows_the_first_figure_as_a_picture_and_a_table(tmp_path):
    page = tmp_path / "study.html"
    page.touch()
    shown = study_in_notebook("paths <1>", results_table(rows()), page)
    assert "paths &lt;1&gt;" in shown and 'src="data:image/png;base64,iVBOR' in shown
    assert shown.count("<tr") == 5 and "saddle" in shown and str(page) in shown


def test_a_notebook_shows_a_single_combination_without_a_picture(tmp_path):
    alone = [row for row in rows() if row.axes == {"path": "circle", "views": 20}]
    shown = study_in_notebook("alone", results_table(alone), tmp_path / "none.html")
    assert "<img" not in shown and shown.count("<tr") == 2 and "none" not in shown
