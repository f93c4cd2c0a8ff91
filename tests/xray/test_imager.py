"""Ownership, refusals, silence and company of the imager."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
from concurrent.futures.thread import _threads_queues
from pathlib import Path

import numpy as np
import pytest
import trimesh
from waiting import HANG_S
from xray_scenes import box, chords, front_view, specimen, sphere

from twinct.core.errors import (
    InputError,
    MemoryShortageError,
    MissingExtraError,
    SpecimenError,
    TwinctError,
)
from twinct.geometry import Panel, Pose
from twinct.scenario import Detector, Source
from twinct.xray import Imager
from twinct.xray.gvxr import GVXR, GvxrEngine

DETECTOR = Detector(columns=64, rows=48, pixel_pitch_mm=5.0)
VIEW = front_view(DETECTOR.panel)
MU = 0.02
HERE = Path(__file__).parent


def ball(centre=(0, 0, 0), radius=30.0):
    return specimen((sphere(centre, radius), MU))


def run_python(code, **environment):
    """A fresh process, since gVXR prints when it is first used and when the process ends."""
    path = os.pathsep.join([str(HERE), *sys.path])
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        env=os.environ | {"PYTHONPATH": path} | environment,
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=False,
    )


SCENE = """
    import numpy as np
    from xray_scenes import front_view, specimen, sphere
    from twinct.geometry import Pose
    from twinct.scenario import Detector, Source
    from twinct.xray import Imager
    detector = Detector(columns=64, rows=48, pixel_pitch_mm=5.0)
    view = front_view(detector.panel)
    parts = specimen((sphere((0, 10, 5), 30), 0.02))
"""


def test_a_second_imager_is_refused_until_the_first_is_closed():
    with Imager(Source(), DETECTOR, ball()) as imager:
        image = imager.render(VIEW, Pose.identity())
        with pytest.raises(TwinctError, match="another X-ray imager is still open"):
            Imager(Source(), DETECTOR, ball(radius=10))
        assert np.array_equal(imager.render(VIEW, Pose.identity()), image)
    imager.close()
    with pytest.raises(TwinctError, match="closed"):
        imager.render(VIEW, Pose.identity())


def test_the_next_imager_finds_nothing_of_the_last_one():
    large = specimen((sphere((0, 0, 0), 60), MU), (box((0, 70, 0), (20, 20, 20)), 0.1))
    with Imager(Source(), Detector(columns=30, rows=20, pixel_pitch_mm=8.0), large):
        pass
    with Imager(Source(), DETECTOR, ball(radius=20.0)) as imager:
        image = imager.render(VIEW, Pose.identity())
    assert (image[chords(VIEW, (0, 0, 0), 26.0) == 0] == 1.0).all()
    assert image.min() == pytest.approx(np.exp(-MU * 40), rel=0.01)


@pytest.mark.process
def test_an_image_does_not_depend_on_what_was_imaged_before():
    """gVXR switches its artefact filter on with the first view on a panel of another size.

    In a process of its own, where no earlier test has taken that first view. The process ends
    before destructors of libraries, here a function that aborts.
    """
    code = """
    import ctypes

    import numpy as np
    from twinct.geometry import Pose
    from twinct.scenario import Detector, Source, Specimen
    from twinct.specimen import build_specimen
    from twinct.trajectory import SinusoidTrajectory, commanded_views
    from twinct.xray import Imager

    libc = ctypes.CDLL(None)
    libc.on_exit(libc.abort, None)
    ball = {"shape": {"kind": "sphere", "radius_mm": 12}, "position_mm": (20, -30, 40)}
    specimen = build_specimen(Specimen(parts=(ball,)))
    path = SinusoidTrajectory(kind="sinusoid", views=8)
    small = Detector(columns=64, rows=48, pixel_pitch_mm=5.0)
    other = Detector(columns=80, rows=40, pixel_pitch_mm=4.0)
    seen = {}
    for detector in (small, small, other, small, other):
        views = commanded_views(path, detector.panel)
        with Imager(Source(), detector, specimen) as imager:
            images = np.array([imager.render(view, Pose.identity()) for view in views])
        np.testing.assert_array_equal(images, seen.setdefault(detector.columns, images))
    """
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True
    )
    assert result.returncode == 0, result.stderr


def test_an_imager_that_failed_or_was_forgotten_does_not_block_the_next():
    with pytest.raises(SpecimenError):
        Imager(Source(), DETECTOR, specimen())
    forgotten = Imager(Source(), DETECTOR, ball())
    del forgotten
    Imager(Source(), DETECTOR, ball()).close()


def test_any_thread_may_render():
    with Imager(Source(), DETECTOR, ball()) as imager:
        here = imager.render(VIEW, Pose.identity())
        there = []
        thread = threading.Thread(target=lambda: there.append(imager.render(VIEW, Pose.identity())))
        thread.start()
        thread.join()
        assert np.array_equal(there[0], here)
        assert np.array_equal(imager.render(VIEW, Pose.identity()), here)


def test_mujoco_may_render_in_between(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><light pos="0 0 3"/><geom type="sphere" size=".3"/>'
        '<camera pos="0 -2 0" xyaxes="1 0 0 0 0 1"/></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with Imager(Source(), DETECTOR, ball()) as imager:
        image = imager.render(VIEW, Pose.identity())
        with mujoco.Renderer(model, 48, 64) as renderer:
            pictures = []
            for _ in range(3):
                renderer.update_scene(data, camera=0)
                pictures.append(renderer.render().copy())
                assert np.array_equal(imager.render(VIEW, Pose.identity()), image)
        assert pictures[0].max() > 50
        assert all(np.array_equal(picture, pictures[0]) for picture in pictures)


def test_specimens_that_cannot_be_imaged_are_all_named():
    open_mesh = sphere((0, 0, 0), 10)
    open_mesh.update_faces(np.arange(len(open_mesh.faces)) > 0)
    inverted = sphere((40, 0, 0), 10)
    inverted.invert()
    empty = trimesh.Trimesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=int))
    parts = specimen(
        (open_mesh, MU), (inverted, MU), (empty, MU), (sphere((0, 0, 0), 1), float("nan"))
    )
    with pytest.raises(SpecimenError) as caught:
        Imager(Source(), DETECTOR, parts)
    assert len(caught.value.problems) == 4
    for problem, word in zip(
        caught.value.problems, ("open", "inside out", "empty", "nan"), strict=True
    ):
        assert word in problem
    with pytest.raises(SpecimenError, match="no parts"):
        Imager(Source(), DETECTOR, specimen())


def test_views_that_are_not_one_view_of_this_panel_are_refused():
    with Imager(Source(), DETECTOR, ball()) as imager:
        with pytest.raises(ValueError, match="one view"):
            imager.render(VIEW[[0, 0]], Pose.identity())
        with pytest.raises(ValueError, match="panel|Panel"):
            imager.render(front_view(Panel(48, 64, 5.0, 4.0)), Pose.identity())


def test_specimen_through_the_panel_or_around_the_source_is_refused():
    def at(x, y=0.0):
        return Pose.from_euler([x, y, 0], [0, 0, 0])

    with Imager(Source(), DETECTOR, ball()) as imager:
        for x in (-400, -300, -271):
            with pytest.raises(TwinctError, match="through the panel"):
                imager.render(VIEW, at(x))
        for x in (300, 275):
            with pytest.raises(TwinctError, match="source is inside"):
                imager.render(VIEW, at(x))
        assert imager.render(VIEW, at(-269)).min() < 0.5
        assert imager.render(VIEW, at(269)).max() < 1.0
        # Beside the panel, behind the source, and the source in a corner of the bounds.
        assert (imager.render(VIEW, at(-300, 400)) == 1.0).all()
        assert (imager.render(VIEW, at(400)) == 1.0).all()
        imager.render(VIEW, Pose.from_euler([278, 20, 20], [0, 0, 0]))
    with Imager(Source(), DETECTOR, specimen((box((-300, 0, 0), (20, 900, 900)), MU))) as imager:
        with pytest.raises(TwinctError, match="through the panel"):
            imager.render(VIEW, Pose.identity())


@pytest.mark.process
def test_silent_from_import_to_exit():
    code = (
        SCENE
        + """
    import os
    os.environ["DISPLAY"] = ":77"
    with Imager(Source(), detector, parts) as closed:
        closed.render(view, Pose.identity())
    never_closed = Imager(Source(), detector, parts)
    image = never_closed.render(view, Pose.identity())
    assert os.environ["DISPLAY"] == ":77"
    print("lowest", round(float(image.min()), 1))
    """
    )
    done = run_python(code)
    assert (done.returncode, done.stdout, done.stderr) == (0, "lowest 0.3\n", "")


def test_without_gvxr_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "gvxrPython3", None)
    with pytest.raises(MissingExtraError, match=r"twinct\[xray\].*--set xray\.engine=mesh"):
        GvxrEngine().acquire([], DETECTOR.panel)


@pytest.mark.parametrize(
    ("why", "told"),
    [
        (
            "libxcb-res.so.0: cannot open shared object file",
            r"libxcb-res.*apt-get install.*libxcb-res0.*--set xray\.engine=mesh",
        ),
        (
            "_gvxr.so: failed to map segment from shared object",
            r"too little memory: _gvxr\.so: failed to map segment from shared object$",
        ),
    ],
)
def test_a_library_that_cannot_be_loaded_is_named_with_the_remedy(monkeypatch, tmp_path, why, told):
    package = tmp_path / "gvxrPython3"
    package.mkdir()
    (package / "__init__.py").write_text(f"raise ImportError({why!r})")
    monkeypatch.syspath_prepend(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "gvxrPython3"]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(InputError, match=told):
        GvxrEngine().acquire([], DETECTOR.panel)


@pytest.mark.process
def test_without_opengl_the_remedy_is_named():
    code = (
        SCENE
        + """
    from twinct.core.errors import InputError
    try:
        Imager(Source(), detector, parts)
    except InputError as error:
        print(error)
    """
    )
    done = run_python(code, __EGL_VENDOR_LIBRARY_DIRS="/nonexistent")
    assert "found no OpenGL" in done.stdout and "libegl1" in done.stdout
    assert done.stderr == ""
    assert done.returncode == 0


def test_errors_of_gvxr_are_raised_as_ours(monkeypatch):
    with Imager(Source(), DETECTOR, ball()) as imager:
        gvxr = GVXR.engine._gvxr
        with monkeypatch.context() as patch:
            patch.setattr(gvxr, "setSourcePosition", lambda *_: gvxr.setSourcePosition_missing())
            with pytest.raises(AttributeError):
                imager.render(VIEW, Pose.identity())
        with monkeypatch.context() as patch:
            patch.setattr(
                gvxr,
                "computeXRayImage",
                lambda *_: gvxr.getLinearAttenuationCoefficient("nobody", "nonsense", 80.0, "keV"),
            )
            with pytest.raises(TwinctError, match="gVXR failed"):
                imager.render(VIEW, Pose.identity())
        assert imager.render(VIEW, Pose.identity()).min() < 0.5


def test_an_interrupt_waits_for_the_call_that_it_meets() -> None:
    """Meanwhile stderr is gVXR's log, which would take the message."""
    heard, done = threading.Event(), []

    def interrupted(number: int, frame: object) -> None:
        heard.set()
        raise KeyboardInterrupt

    def drawn() -> None:
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)
        heard.wait(HANG_S)
        done.append(True)

    before = signal.signal(signal.SIGINT, interrupted)
    try:
        with pytest.raises(KeyboardInterrupt):
            GvxrEngine()._call(drawn)
    finally:
        signal.signal(signal.SIGINT, before)
    assert done


def test_a_thread_interrupted_at_its_start_ends_with_the_process(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def started(thread: threading.Thread, start=threading.Thread.start) -> None:
        start(thread)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(threading.Thread, "start", started)
    engine = GvxrEngine()
    with pytest.raises(KeyboardInterrupt):
        engine._call(int)
    assert engine._thread._threads
    assert engine._thread._threads <= set(_threads_queues)


def test_gvxr_is_not_loaded_into_too_little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its libraries would end the process without a message."""
    limit = (2.0 * 2**30, "limit of this process (ulimit)")
    monkeypatch.setattr("twinct.core.memory._limits", lambda: iter([limit]))
    with pytest.raises(MemoryShortageError, match="at least 2500 MiB are needed by gVXR"):
        GvxrEngine().prepare()
