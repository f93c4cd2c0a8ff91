"""All commands, in the order of the help; their arguments are in the files of this package."""

from __future__ import annotations

import tyro

from twinct.cli.calibrate import calibrate
from twinct.cli.ctsimu import ctsimu
from twinct.cli.demo import demo
from twinct.cli.drive import drive
from twinct.cli.finished import (
    compare,
    export,
    geometry,
    import_,
    reconstruct,
    report,
    verify,
)
from twinct.cli.planning import motion, place, plan, reach, uncertainty
from twinct.cli.predict import predict
from twinct.cli.running import node, run, view
from twinct.cli.scenarios import check, render, schema, specimen, urdf
from twinct.cli.study import study

app = tyro.extras.SubcommandApp()

for command in (demo, check, run, view, render, reach, plan, uncertainty, place, node, urdf):
    app.command(command)
for command in (schema, motion, drive, specimen, export):
    app.command(command)
app.command(name="import")(import_)
for command in (report, compare, verify, reconstruct, predict, geometry):
    app.command(command)
app.command(
    calibrate,
    name="calibrate",
    help="Estimate the executed poses of source and detector, and add them as a geometry.",
)
app.command(study)
app.command(ctsimu, name="ctsimu", help="Scenarios in the CTSimU format: render, export, qualify.")
