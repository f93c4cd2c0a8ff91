"""
A study
=======

One scan is one sample. A study varies keys of a scenario, repeats each trial with other seeds,
and computes nothing twice. You will find out how many passes SART should make when the believed
poses are noisy.
"""

# %%
# The file
# --------
#
# A study names a scenario, the keys that vary, and the number of repetitions. All axes are
# crossed: 3 x 2 x 3 trials here.

from pathlib import Path

import matplotlib.pyplot as plt

from twinct import run_study

Path("passes.yaml").write_text("""
name: passes of SART and noise of the poses
scenario: circle_gantry
set:
  trajectory.views: 40
  detector: {columns: 80, rows: 60, pixel_pitch_mm: 4.0}
  uncertainty.source.cutoff_mm: 3
  uncertainty.detector.cutoff_mm: 3
  reconstruction.algorithm: sart
  reconstruction.grid: {voxels: 64, voxel_mm: 2.5}
axes:
  - {key: reconstruction.iterations, values: [1, 3, 10]}
  - label: sigma / mm
    key: [uncertainty.source.sigma_mm, uncertainty.detector.sigma_mm]
    values: [0, 1]
repetitions: {number: 3, key: uncertainty.seed}
figures: [image.rmse_near_rel]
""")

# %%
# Trials that differ in the reconstruction or in the noise of the poses share one scan: the images
# are made once. On the command line this is ``twinct study passes.yaml --out passes``.

study = run_study("passes.yaml", "passes", jobs=1)

# %%
# The table
# ---------
#
# The table has a row for each trial. In the folder, ``results.parquet`` holds this table, and
# ``study.html`` shows the results as diagrams and tables.

table = study.results
print(len(table), "trials,", sorted({one for one in table.columns if "rmse_near" in one}))

# %%
# The answer
# ----------
#
# With exact poses, more passes still lower the error; with wrong poses, they only fit the errors.

passes, sigma = "reconstruction.iterations", "sigma / mm"
figure, axis = plt.subplots(figsize=(6.5, 3.6), layout="constrained")
for value, rows in table.groupby(sigma):
    error = 100 * rows.groupby(passes)["image.rmse_near_rel"].agg(["mean", "std"])
    axis.errorbar(
        error.index, error["mean"], error["std"], marker="o", capsize=4, label=f"{value:g} mm"
    )
axis.set(xlabel="passes of SART", ylabel="error near bone / %", xscale="log")
axis.legend(title="noise of the poses")

# %%
# A study may also search instead of trying all combinations, keep volumes, and use several
# machines: ``--address`` names a Ray cluster.
