"""``python fake_node.py {robots,xray} SCENARIO ...``: a node of a scan around a tiny engine."""

import fcntl
import json
import os
import sys
from pathlib import Path

import numpy as np

from twinct.core.errors import MotionError
from twinct.geometry.wire import JointSample, PosePairs, Reached

STATE = 5
REFUSED_X_M = 9.0
"""A source target beyond this x is refused by the fake robots."""


AT_HOME_M = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
SPECIMEN_M = (0.0, 0.0, 1 / 3, 0.0, 0.0, 0.0, 1.0)


class FakeRobots:
    """Reaches every target up to a number that depends on how many moves came before."""

    joint_names = ("source_a", "source_b", "detector_a", "detector_b")
    on_joints = None

    def __init__(self):
        self.moves = 0

    def follow(self, plan):
        pass

    def restore(self, state):
        self.moves = int(state[0])

    def move(self, view, target):
        ((source, detector),) = target.sevens
        if source[0] > REFUSED_X_M or _told("short_arm"):
            raise MotionError("the source arm is too short", ["source"])
        _note("move", source)
        self.moves += 1
        joints = np.arange(4) / 3 + self.moves
        if self.on_joints is not None:
            under_way = joints - 0.5, joints / 5, joints / 9
            self.on_joints(JointSample(self.moves / 3 - 0.1, self.joint_names, *under_way))
        source = (source[0] + self.moves * 1e-4 / 3, *source[1:])
        return Reached(
            executed=PosePairs.from_sevens([(source, SPECIMEN_M, detector)]),
            joint_names=self.joint_names,
            position=joints,
            velocity=joints / 7,
            effort=-joints / 11,
            state=np.array([self.moves, *np.random.default_rng(self.moves).normal(size=STATE)]),
            time_s=self.moves / 3,
            clearance_mm=100 / self.moves,
            since_middle_s=1 / 300,
        )

    def home(self):
        if _told("short_arm"):
            raise MotionError("the source arm is too short", ["source"])
        return self.move(None, PosePairs.from_sevens([(AT_HOME_M, AT_HOME_M)]))

    def idle(self, seconds):
        """Its time counts moves alone."""
        return self.moves / 3

    def close(self):
        pass


class FakeImager:
    """An image whose pixels are a function of the geometry's last bits."""

    def __init__(self, panel):
        self.shape = panel.shape

    def expose(self, path, view=0, before=None, *, time_s=0.0):
        source, detector = path[0]
        _note("render", source.position.tolist())
        _wait_at_gate(view)
        axes = detector.rotation[:, 0]
        poses = (source.position, detector.position, axes, path.object[0].position)
        scale = sum(float(numbers.sum()) for numbers in poses)
        pixels = np.arange(np.prod(self.shape), dtype=np.float64) * scale
        image = pixels.astype(np.float32).reshape(self.shape)
        return image[:1, :1] if _told("one_pixel") else image

    def close(self):
        pass


def _told(what):
    """A number that a test asks for, else 0."""
    file = Path(os.environ.get("FAKE_NOTES", "/nowhere")) / what
    return float(file.read_text()) if file.exists() else 0


def _wait_at_gate(view):
    """Take no image, from a first view on, while a test holds the gate: ``Notes.renders_held``."""
    gate = Path(os.environ.get("FAKE_NOTES", "/nowhere")) / "gate"
    try:
        held = gate.open()
    except FileNotFoundError:
        return
    with held:
        if view >= int(held.read()):
            fcntl.flock(held, fcntl.LOCK_SH)


def _note(what, value):
    """Keep count of the work done, where a test asks for it."""
    if folder := os.environ.get("FAKE_NOTES"):
        with (Path(folder) / what).open("a") as notes:
            notes.write(json.dumps(value) + "\n")


if __name__ == "__main__":
    from twinct.link import heartbeat
    from twinct.link.__main__ import main

    heartbeat.SILENCE_S = float(os.environ.get("FAKE_SILENCE_S", heartbeat.SILENCE_S))
    sys.exit(
        main(
            build_robots=FakeRobots,
            build_imager=FakeImager,
        )
    )
