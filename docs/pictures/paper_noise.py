"""Make the table and picture of docs/paper_noise.md from examples/studies/paper_noise.yaml.

    twinct study examples/studies/paper_noise.yaml --out out/paper_noise
    python docs/pictures/paper_noise.py out/paper_noise

Given the folder of the study, store its figures in benchmarks/results/paper_noise.csv; otherwise
read them from there. Draw the picture and print the table: mean and half the 95 % interval over ten
seeds.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from twinct import load_results
from twinct.report.repetitions import mean_of

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "benchmarks" / "results" / "paper_noise.csv"
PICTURE = ROOT / "docs" / "images" / "paper_noise.png"
SIGMA, ITERATIONS = "sigma / mm", "reconstruction.iterations"
FIGURES = {
    "image.rmse_near_rel": ("RMSE within 3 mm of bone / %", 100, 2),
    "image.rmse_rel": ("RMSE in the region / %", 100, 2),
    "image.mean_reference_rel": ("mean bone value / %", 100, 2),
    "image.psnr_db": ("PSNR / dB", 1, 2),
    "image.ssim_near": ("SSIM near bone", 1, 4),
    "image.ssim": ("SSIM in the region", 1, 4),
    "image.edge_width_mm": ("bone edges, 10 to 90 % / mm", 1, 3),
}
ERROR = "geometries.believed.pose_error.source.position_mm.mean"


def kept(folder: Path) -> pd.DataFrame:
    """Write the figures of a study to the CSV file and return them; all 60 trials must be done."""
    table = load_results(folder)
    if not (done := table.status == "done").all():
        raise SystemExit(f"{folder}: {(~done).sum()} trials failed")
    table = table.loc[:, [ITERATIONS, SIGMA, "seed", *FIGURES, ERROR]]
    if len(table) != 60:
        raise SystemExit(f"{folder}: {len(table)} of 60 trials are there")
    KEPT.parent.mkdir(exist_ok=True)
    table.to_csv(KEPT, index=False, float_format="%.9g")
    return table


def combinations(table: pd.DataFrame) -> Iterator[tuple[int, float, pd.DataFrame]]:
    """Yield iterations, sigma (mm) and the rows of ten seeds of each combination."""
    for iterations in sorted(set(table[ITERATIONS].tolist())):
        for sigma in sorted(set(table[SIGMA].tolist())):
            same = (table[ITERATIONS] == iterations) & (table[SIGMA] == sigma)
            yield int(iterations), float(sigma), table.loc[same]


def told(table: pd.DataFrame) -> str:
    """Return a Markdown table with mean and interval of each figure, a row per combination."""
    names = [name for name, _, _ in FIGURES.values()]
    lines = [f"| iterations | sigma / mm | {' | '.join(names)} |", "|---" * (2 + len(names)) + "|"]
    for iterations, sigma, rows in combinations(table):
        cells = []
        for figure, (_, factor, digits) in FIGURES.items():
            mean, half, _ = mean_of((rows[figure] * factor).tolist())
            assert mean is not None and half is not None, "ten seeds"
            cells.append(f"{mean:.{digits}f}" + (f" ± {half:.{digits}f}" if sigma else ""))
        lines.append(f"| {iterations} | {sigma:g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def draw(table: pd.DataFrame) -> None:
    """Draw each figure over the noise: a dot per seed, and the mean with its interval."""
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    shown = [name for name in FIGURES if name != "image.rmse_rel"]
    panels = figure.subplots(2, 3, sharex=True).ravel()
    for axes, name in zip(panels, shown, strict=True):
        label, factor, _ = FIGURES[name]
        for iterations, colour, shift in ((3, "C0", -0.006), (10, "C1", 0.006)):
            rows = table.loc[table[ITERATIONS] == iterations]
            axes.plot(rows[SIGMA] + shift, rows[name] * factor, ".", color=colour, alpha=0.3, ms=4)
            means = [
                (sigma, *mean_of((same[name] * factor).tolist()))
                for number, sigma, same in combinations(table)
                if number == iterations
            ]
            axes.errorbar(
                [sigma + shift for sigma, *_ in means],
                [mean for _, mean, _, _ in means],
                [half for _, _, half, _ in means],
                fmt="o-",
                color=colour,
                ms=4,
                capsize=3,
                label=f"{iterations} iterations",
            )
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    figure.supxlabel("noise of the believed positions along each axis, sigma / mm", fontsize=10)
    panels[0].legend(frameon=False)
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, dpi=110)


def main() -> None:
    """Store the figures of a given study, draw the picture and print the table."""
    table = kept(Path(sys.argv[1])) if len(sys.argv) > 1 else pd.read_csv(KEPT)
    draw(table)
    print(told(table))
    for iterations, sigma, rows in combinations(table):
        if iterations == 3:
            print(f"sigma {sigma:g} mm: believed {rows[ERROR].mean():.3f} mm off executed, mean")
    print(f"wrote {PICTURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
