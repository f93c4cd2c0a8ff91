"""The CTSimU qualification suite: our samples and images, judged by BAM's toolbox."""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError, MissingExtraError
from twinct.core.files.links import look_through, no_link, own_folder
from twinct.core.files.writing import remove_folder, storage_errors, write_json
from twinct.ctsimu.outputs import Options, OutputPaths
from twinct.ctsimu.render import render
from twinct.ctsimu.scenario import load_ctsimu
from twinct.ctsimu.suite.cases import NOT_TAKEN, TESTS, cases
from twinct.ctsimu.suite.verdicts import SuiteVerdict, verdicts
from twinct.ctsimu.writing import make_folder

__all__ = ["NOT_TAKEN", "TESTS", "SuiteVerdict", "qualify"]


def qualify(
    folder: Path, tests: Sequence[str] = TESTS, *, step: Callable[[str], None] = lambda name: None
) -> list[SuiteVerdict]:
    """Build the samples, render the images, and evaluate them with the toolbox.

    Existing images are evaluated again, not rendered again. Each test has its own folder; figures
    of merit are written to ``qualification.json``. ``step`` is called with the name of each
    rendering before it starts.

    Raises:
        InputError: a test does not exist.
        MissingExtraError: the toolbox is not installed.
        StorageError: the folder cannot be written.
    """
    unknown = [name for name in tests if name not in TESTS]
    if unknown:
        left_out = [
            f"{name} is not supported: {NOT_TAKEN[name]}" for name in NOT_TAKEN if name in tests
        ]
        wrong = f"unknown tests {', '.join(unknown)}; choose from {', '.join(TESTS)}"
        raise InputError([wrong, *left_out])
    _toolbox()
    make_folder(folder)
    verdicts: list[SuiteVerdict] = []
    for test in tests:
        with storage_errors(folder):
            verdicts += _judged(test, folder / test, step)
            figures = {"figures": [asdict(v) for v in verdicts], "not_taken": NOT_TAKEN}
            write_json(folder / "qualification.json", figures)
    return verdicts


def _judged(test: str, folder: Path, step: Callable[[str], None]) -> list[SuiteVerdict]:
    """Render what is missing, run the toolbox with its output in a log, and read its results."""
    look_through(own_folder(folder))
    for case in cases([test]):
        step(case.name)
        scenario = load_ctsimu(case.write(folder))
        options = Options(case.samples, case.spot_points)
        render(scenario, folder, options, resume=OutputPaths(folder, case.name).key.exists())
    toolbox = _toolbox()
    renderings = {case.key: str(OutputPaths(folder, case.name).metadata) for case in cases([test])}
    results = folder / f"{test}-results"
    remove_folder(results)
    with (
        open(folder / "toolbox.log", "w", opener=no_link) as log,
        contextlib.redirect_stdout(log),
        warnings.catch_warnings(),
        _true_rotation() if test == "2D-WE-2" else contextlib.nullcontext(),
    ):
        warnings.simplefilter("ignore")
        if "" in renderings:
            toolbox(test, renderings[""])
        else:
            toolbox(test, **renderings)
    return verdicts(test, results)


@contextlib.contextmanager
def _true_rotation() -> Iterator[None]:
    """Make the toolbox rotate its reference edge, which version 1.7 shears.

    Its ``Vector.rotate_2D_xy`` computes y from the rotated x: the edge of 3 deg is at 3.008 deg on
    one side and 2.996 deg on the other, 0.07 pixels off at its ends. Only the figures of 2D-WE-2
    depend on it.
    """
    from ctsimu.primitives import Vector

    def rotate(self: Any, angle: float) -> None:
        x, y = self.x(), self.y()
        self.set_x(x * math.cos(angle) - y * math.sin(angle))
        self.set_y(x * math.sin(angle) + y * math.cos(angle))

    original = Vector.rotate_2D_xy
    Vector.rotate_2D_xy = rotate
    try:
        yield
    finally:
        Vector.rotate_2D_xy = original


def _toolbox() -> Callable[..., object]:
    try:
        from ctsimu.toolbox import Toolbox
    except ModuleNotFoundError as error:
        raise MissingExtraError("ctsimu", "ctsimu") from error
    return Toolbox
