"""Error terms that state how far they spread, and no more: draws and covariances follow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from twinct.calibration.arm_calibration import arm_prior, view_covariance
from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, chains_of
from twinct.scenario import Uncertainty, ViewErrors
from twinct.uncertainty import TrueCell
from twinct.uncertainty.error_terms import ErrorSettings, ErrorTerm, Spread, ToolMotion, size
from twinct.uncertainty.propagation import NominalScan, draw, first_order
from twinct.uncertainty.terms import registry

DRAWS, VIEWS = 3000, 3
QUIET = {"source": {"sigma_mm": 0}, "detector": {"sigma_mm": 0}}
SECTION = Uncertainty.model_validate({**QUIET, "views": {"source_mm": 1}})
TWIST = np.array([0.1, 0.0, 0.2, 1e-4, 3e-4, 0.0])


@pytest.fixture
def scan(cell: CellModel) -> NominalScan:
    rng = np.random.default_rng(5)
    joints = np.tile([0.1, -2.0, 2.0, 0.1, 1.6, 0.2], 2) + rng.uniform(-0.3, 0.3, (VIEWS, 12))
    return NominalScan.of_arms(
        chains_of(cell), joints, rng.normal(size=(VIEWS, 12)), np.arange(3.0)
    )


@pytest.fixture
def only(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Make one spread the only error."""

    def put(spread: Spread) -> None:
        def spreads(_: ViewErrors, motion: ToolMotion) -> Iterator[Spread]:
            yield spread

        term = ErrorTerm("odd", ViewErrors, spreads, (spread.place,), "views")
        monkeypatch.setattr(registry, "BUILT_IN", {"odd": term})

    return put


SPREADS = {
    "base": Spread("base", TWIST, draws="side"),
    "links": Spread("links", np.outer(np.arange(6.0), TWIST)),
    "links of a view": Spread("links", TWIST, length=0.0),
    "joints": Spread("joints", np.full((VIEWS, 6), 3e-4), length=2.0),
    "joints of both": Spread("joints", np.full(6, 3e-4), length=0.0, draws="all"),
    "tool": Spread("tool", np.outer([1.0, 2.0, 3.0], TWIST)),
    "pose": Spread("pose", TWIST, draws="all"),
    "pose of a view": Spread("pose", TWIST, length=1.0),
}


@pytest.mark.parametrize("name", SPREADS)
def test_draws_spread_as_the_covariance_says(scan: NominalScan, only: Any, name: str) -> None:
    only(SPREADS[name])
    analytic = first_order(SECTION, scan)
    blocks = [[analytic.covariance(a, b) for b in range(VIEWS)] for a in range(VIEWS)]
    errors = np.concatenate([part.errors for _, part in draw(SECTION, scan, DRAWS, 1, 2)], axis=1)
    expected, drawn = np.block(blocks), np.cov(errors.reshape(DRAWS, -1).T)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    moved = scale > 1e-12
    assert moved.any() and np.abs(drawn[~moved]).max(initial=0.0) < 1e-10
    # 3000 draws: standard error 2.6 % of a variance, 1.8 % of a correlation
    assert np.abs((drawn - expected)[moved] / scale[moved]).max() < 0.12


@pytest.mark.parametrize("name", ["base", "links", "pose"])
def test_the_first_draw_is_the_scan(
    cell: CellModel, scan: NominalScan, only: Any, name: str
) -> None:
    only(SPREADS[name])
    [(_, drawn)] = draw(SECTION, scan, 2, 1, 2)
    true, still = TrueCell(SECTION, 1, 2, chains_of(cell)), Pose.identity()
    for view in range(VIEWS):
        at = [Pose.from_matrix(m[:3, 3], m[:3, :3]) for m in scan.poses[:, view]]
        joints, speeds = (
            np.concatenate([own[view] for own in of]) for of in (scan.joints, scan.speeds)
        )
        real = true.at(PosePairs.at(*at, still), view, float(view), joints, speeds)
        for side, pose in enumerate(real[0]):
            np.testing.assert_allclose(pose.matrix, drawn.true[side, 0, view], atol=1e-9)


def test_a_systematic_error_is_no_spread(scan: NominalScan, only: Any) -> None:
    only(Spread("pose", TWIST, draws="none"))
    analytic = first_order(SECTION, scan)
    [mean] = analytic.means
    [(_, drawn)] = draw(SECTION, scan, 2, 1, 2)
    assert mean.name == "odd, mean" and not analytic.terms
    np.testing.assert_allclose(drawn.errors[1], mean.factor[..., 0], atol=1e-3)


def test_a_gantry_has_no_error_of_arms(random_geometry: Any, only: Any) -> None:
    views = random_geometry(2, Panel(48, 64, 5.0, 5.0), np.random.default_rng(0))
    gantry = NominalScan.of_gantry(views, np.arange(2.0))
    only(SPREADS["pose"])
    assert [term.name for term in first_order(SECTION, gantry).terms] == ["odd"]
    only(SPREADS["base"])
    with pytest.raises(InputError, match=r"uncertainty\.views: this error belongs to arms"):
        first_order(SECTION, gantry)


def test_a_calibration_expects_the_spreads(scan: NominalScan, only: Any) -> None:
    motions = scan.motion(0), scan.motion(1)
    before = arm_prior(Uncertainty.model_validate({"preset": "collaborative"}), motions[0])
    only(SPREADS["joints"]._replace(length=np.inf))
    after = arm_prior(SECTION, motions[0])
    assert after.link == pytest.approx([0, 0, 0, 0, 0, 3e-4]) and before.link[0] > 0
    only(SPREADS["pose of a view"])
    squares = np.diag(view_covariance(SECTION, motions))
    assert squares == pytest.approx(np.concatenate([TWIST[:3], TWIST]) ** 2)


def test_the_size_of_a_term_is_not_negative_unless_it_has_a_sign() -> None:
    class Sag(ErrorSettings):
        mm: float = size("Way down.")
        ms: float = size("Delay.", signed=True)

    assert Sag(mm=1, ms=-2).sizes == (1, -2)
    with pytest.raises(ValueError, match="greater than or equal to 0"):
        Sag(mm=-1)
