"""Modules that have another name now: the old one still imports, with a warning."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

RENAMED = {
    "twinct.calibration.arms": "twinct.robots.calibrated_arms",
    "twinct.cell": "twinct.robots.cell",
    "twinct.cli.results": "twinct.cli.summary",
    "twinct.cluster": "twinct.workers.cluster",
    "twinct.core.kept": "twinct.core.cached",
    "twinct.draws": "twinct.core.draws",
    "twinct.errors": "twinct.core.errors",
    "twinct.evaluate": "twinct.evaluation",
    "twinct.evaluation.places": "twinct.evaluation.region_voxels",
    "twinct.evaluation.region": "twinct.geometry.region",
    "twinct.evaluation.sight": "twinct.evaluation.visibility",
    "twinct.extensions": "twinct.core.extensions",
    "twinct.extras": "twinct.core.extras",
    "twinct.files": "twinct.core.files",
    "twinct.files.below": "twinct.core.files.folder_paths",
    "twinct.gantry": "twinct.robots.gantry",
    "twinct.link.recording.definitions": "twinct.link.definitions",
    "twinct.measured.residuals": "twinct.recon.residuals",
    "twinct.memory": "twinct.core.memory",
    "twinct.motion": "twinct.robots.motion",
    "twinct.motion.detour": "twinct.robots.motion.path_planner",
    "twinct.motion.glance": "twinct.robots.motion.collision_check",
    "twinct.motion.homeward": "twinct.robots.motion.return_path",
    "twinct.motion.way": "twinct.robots.motion.path_search",
    "twinct.planning": "twinct.view_planning",
    "twinct.planning.completeness": "twinct.view_planning.objectives.completeness",
    "twinct.planning.detectability": "twinct.view_planning.objectives.detectability",
    "twinct.planning.dose": "twinct.view_planning.objectives.dose",
    "twinct.planning.metal": "twinct.view_planning.objectives.metal_paths",
    "twinct.planning.moving": "twinct.view_planning.objectives.motion_time",
    "twinct.planning.sight": "twinct.view_planning.objectives.visibility",
    "twinct.planning.variance": "twinct.view_planning.objectives.variance",
    "twinct.pool": "twinct.workers",
    "twinct.pool.parcel": "twinct.workers.artifact",
    "twinct.progress": "twinct.core.progress",
    "twinct.reach": "twinct.robots.reach",
    "twinct.recon.known": "twinct.recon.known_components",
    "twinct.recon.settings": "twinct.recon.shared_keys",
    "twinct.recon.volume_formats.known": "twinct.recon.volume_formats.registry",
    "twinct.record": "twinct.link.recording",
    "twinct.record.messages": "twinct.link.plain",
    "twinct.record.reading": "twinct.link.recording.reader",
    "twinct.record.rebuilt": "twinct.link.recording.recovery",
    "twinct.record.topics": "twinct.link.topics",
    "twinct.report.found": "twinct.report.algorithm_results",
    "twinct.report.view_plan": "twinct.view_plans.picture",
    "twinct.report.view_tried": "twinct.view_plans.trial_picture",
    "twinct.ros": "twinct.link",
    "twinct.ros.plan": "twinct.link.joint_trajectory",
    "twinct.ros.pulse": "twinct.link.heartbeat",
    "twinct.ros.station": "twinct.link.participant",
    "twinct.runs.again": "twinct.runs.reconstruction",
    "twinct.runs.calibrating": "twinct.calibration.scan_calibration",
    "twinct.runs.kept": "twinct.runs.reconstruction_folder",
    "twinct.runs.kinematics": "twinct.calibration.arm_calibration",
    "twinct.runs.mending": "twinct.runs.repair",
    "twinct.runs.metal": "twinct.runs.metal_reduction",
    "twinct.runs.named": "twinct.runs.regions",
    "twinct.runs.view_candidates": "twinct.view_plans.candidates",
    "twinct.runs.view_exposure": "twinct.view_plans.mas",
    "twinct.runs.view_family": "twinct.view_plans.family_search",
    "twinct.runs.view_goals": "twinct.view_plans.task_goals",
    "twinct.runs.view_journal": "twinct.view_plans.journal",
    "twinct.runs.view_plan": "twinct.view_plans.planner",
    "twinct.runs.view_rejudged": "twinct.view_plans.goals_with_errors",
    "twinct.runs.view_scout": "twinct.view_plans.scout",
    "twinct.runs.view_tried": "twinct.view_plans.trial",
    "twinct.runs.view_work": "twinct.view_plans.search_work",
    "twinct.scan.findings": "twinct.scan.damage",
    "twinct.scan.named": "twinct.scan.named_geometries",
    "twinct.scan.told": "twinct.scan.encoder_model",
    "twinct.scan.workshop": "twinct.scan.builder",
    "twinct.settings": "twinct.core.settings",
    "twinct.shadow": "twinct.recon.shadow",
    "twinct.study.book": "twinct.study.timings",
    "twinct.study.figures": "twinct.study.trial_figures",
    "twinct.study.shelf": "twinct.study.cache",
    "twinct.study.taking": "twinct.study.trial",
    "twinct.threads": "twinct.core.threads",
    "twinct.uncertainty.alike": "twinct.uncertainty.correlation",
    "twinct.view": "twinct.viewer",
    "twinct.view.export": "twinct.viewer.single_file",
    "twinct.view.folder": "twinct.viewer.run_folder",
    "twinct.view.found": "twinct.viewer.locate",
    "twinct.view.page": "twinct.viewer.live_page",
    "twinct.views": "twinct.geometry.wire",
    "twinct.volume": "twinct.recon.volume",
}
"""New names of packages and modules, by their old ones."""


class _Alias(Loader):
    """Import a module by its new name."""

    def __init__(self, new: str) -> None:
        self.new = new

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module itself, so that its classes stay the same ones."""
        module = import_module(self.new)
        self._own = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give back what the import system has set."""
        module.__spec__ = self._own


class _OldNames(MetaPathFinder):
    """Find renamed modules, before other finders load their files a second time."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of the renamed module; None if the name is not an old one."""
        old = fullname
        while old not in RENAMED:
            old = old.rpartition(".")[0]
            if not old:
                return None
        new = RENAMED[old] + fullname[len(old) :]
        warnings.warn(f"{fullname} is now {new}", DeprecationWarning, stacklevel=2)
        return ModuleSpec(fullname, _Alias(new), is_package=True)


class Package(ModuleType):
    """The package ``twinct``, in which a function may have the name of a renamed module."""

    def __setattr__(self, name: str, value: object) -> None:
        """Set an attribute, but no renamed module, which the import system would set."""
        if not (isinstance(value, ModuleType) and f"{self.__name__}.{name}" in RENAMED):
            super().__setattr__(name, value)


def old_names(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """Return a module's ``__getattr__`` that finds what has another name now, with a warning.

    Args:
        module: name of the module.
        names: new names by the old ones; with dots, from another module.
    """

    def found(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        owner, _, new = names[name].rpartition(".")
        owner = owner or module
        warnings.warn(f"{module}.{name} is now {owner}.{new}", DeprecationWarning, stacklevel=2)
        return getattr(import_module(owner), new)

    return found


def old_attribute(old: str, new: str) -> Any:
    """Return a property that gives an attribute with another name now, with a warning."""

    def found(self: object) -> Any:
        owner = type(self).__name__
        warnings.warn(f"{owner}.{old} is now {owner}.{new}", DeprecationWarning, stacklevel=2)
        return getattr(self, new)

    return property(found)


def install(package: str) -> None:
    """Let the old names import from now on."""
    sys.meta_path.insert(0, _OldNames())
    sys.modules[package].__class__ = Package
