"""Names and messages on the page, which a stranger's folder may have made."""

from __future__ import annotations

import html
from contextlib import closing
from dataclasses import replace

import pytest
from listener import Listener
from markdown_it import MarkdownIt
from waiting import HANG_S

from twinct.runs import Run
from twinct.viewer.live_page import Page
from twinct.viewer.markdown import plain
from twinct.viewer.numbers import of_joints, of_point, of_view
from twinct.viewer.run_folder import RunFolder
from twinct.viewer.server import Server, address

BAD = "<img src=x onerror=alert(1)>"

TEXTS = (
    *(BAD, "<script>alert(1)</script>", "a < b & c > d", "&lt;b&gt; &#60;"),
    *("</h3><style>*{}</style>", "[here](http://example.org)", "![](http://example.org/x.png)"),
    *("<http://example.org>", "*a* _b_ **c** `d` ~~e~~", "a\n\n# b", "a\n---", "    code"),
    *("1. one", "- [x] done", "> said", "a | b", "\\*a\\*", "back\\", "``", "[^1]: note"),
    *("paper_noise-2, 0.3 mm", "Schädel_ü*", ""),
)


def shown(text: str) -> str:
    """The HTML of a Markdown text in which HTML may stand, as on the page."""
    return MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"]).render(text)


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_is_shown_as_it_is(text: str) -> None:
    wanted = html.escape(" ".join(text.split()), quote=False).replace('"', "&quot;")
    assert shown(f"### {plain(text)}\nx") == f"<h3>{wanted}</h3>\n<p>x</p>\n"
    if wanted:
        assert f"<td>{wanted}</td>" in shown(f"| a | b |\n|---|---|\n| {plain(text)} | 1 |")
        assert shown(f"**{plain(text)}**") == f"<p><strong>{wanted}</strong></p>\n"


def test_as_it_stands_it_would_run() -> None:
    """Else the tests here would say nothing."""
    assert BAD in shown(BAD)


def test_names_of_a_run_are_text_on_the_page(server: Server, finished: Run) -> None:
    show = RunFolder(finished.paths.path).look()
    assert show.plan is not None
    bad = replace(
        show,
        name=BAD,
        state=BAD,
        problems=(BAD,),
        poses={**show.poses, BAD: show.poses["believed"]},
        volumes={BAD: next(iter(show.volumes.values()))},
        plan=replace(show.plan, joint_names=(f"{BAD}_1", *show.plan.joint_names[1:])),
    )
    with closing(Page(server)) as page:
        page.put(0, bad)
        page.say(BAD)
        assert page.settle(HANG_S)
        with closing(Listener(address(server))) as listener:
            listener.catch_up(page)
            assert listener.texts().count(BAD) >= 5  # name, state, problem, said, a geometry
            assert BAD not in listener.markdown() and BAD not in shown(listener.markdown())
        page._complain(BAD)
        assert BAD not in page._head.content
    middle = bad.volumes[BAD].grid.world_from_grid.position
    for told in (
        of_view(bad, 0),
        of_joints(bad, 0, f"{BAD}_link"),
        of_point(bad, middle, "slice"),
    ):
        assert told is not None and plain(BAD) in told and BAD not in told
