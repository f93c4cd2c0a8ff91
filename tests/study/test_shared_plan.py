"""Trials that differ in errors and noise share one plan, and find the same as with their own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest

from twinct.core.cached import forget
from twinct.robots import motion
from twinct.scenario import load_scenario, stage_digests
from twinct.study import trial
from twinct.study.trial import TrialSpec, try_trial

SMALL = Path(__file__).parents[1] / "same_bytes" / "small.yaml"
QUICK = [
    "xray.engine=mesh",
    "trajectory.views=3",
    "cell.timestep_ms=4",
    "reconstruction.grid={voxels: 16, voxel_mm: 10}",
    "reconstruction.iterations=1",
    "detector.noise={kind: snr, snr: 50}",
]


class Here:
    """A node's place of work in this process."""

    threads = 1
    attached: Mapping[str, Path] = MappingProxyType({})

    def __init__(self, folder: Path) -> None:
        folder.mkdir()
        self.folder = folder

    def fetch(self, name: str) -> Path:
        raise AssertionError(f"nobody offers {name}")

    def attach(self, name: str, path: Path) -> None:
        raise AssertionError(f"only figures are kept, not {name}")


def spec_of(number: int, seed: int, tool_mm: float) -> TrialSpec:
    keys = [*QUICK, f"seed={seed}", f"uncertainty.arms.tool_mm={tool_mm}"]
    scenario = load_scenario(SMALL, keys)
    scan = stage_digests(scenario)["images"]
    data = json.loads(scenario.resolved())
    return TrialSpec(f"trial{number}", data, {}, scan, shared=False, keep="figures", link="local")


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The digests of the plans that are made; nothing is kept from tests before."""
    made: list[str] = []
    plan_motion = motion.plan_motion

    def noted(*arguments: Any, **keys: Any) -> Any:
        plan = plan_motion(*arguments, **keys)
        made.append(plan.digest)
        return plan

    monkeypatch.setattr(motion, "plan_motion", noted)
    monkeypatch.setattr(trial, "_started", True)
    return made


def tried_by_another_worker(spec: TrialSpec, node: Here) -> dict[str, Any]:
    for kind in ("plan", "scan", "truth"):
        forget(kind)
    return try_trial(spec, node)


def test_seeds_and_errors_share_a_plan_and_find_the_same_as_alone(
    tmp_path: Path, plans: list[str]
) -> None:
    specs = [spec_of(i, *one) for i, one in enumerate([(0, 0.2), (1, 0.4)])]
    node = Here(tmp_path / "node")
    together = [tried_by_another_worker(spec, node) for spec in specs]
    assert len(plans) == 1
    alone = tried_by_another_worker(specs[1], Here(tmp_path / "alone"))
    assert len(plans) == 2 and len({*plans}) == 1
    assert together[1]["figures"] == alone["figures"]
    assert together[1]["sections"] == alone["sections"]
    found = [one["figures"]["pose_error.source.position_mm.mean"] for one in together]
    assert len({*found}) == 2  # the errors differ, and so do the executed poses
