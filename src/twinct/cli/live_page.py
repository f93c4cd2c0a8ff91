"""The page of a run or a scenario in a browser: its server, and its address on the terminal."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

from twinct.cli.progress import on_terminal, say
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.private import temporary_folder
from twinct.design.draft import open_draft
from twinct.design.page import DesignPage
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario, named_places
from twinct.viewer.filling import builder_of, fill
from twinct.viewer.following import FolderPoller, LivePage
from twinct.viewer.live_page import Page
from twinct.viewer.locate import folder_of_run
from twinct.viewer.movie import write_movie
from twinct.viewer.planned import planned
from twinct.viewer.run_folder import RunFolder
from twinct.viewer.server import Server, address, by_ssh, close, is_loopback, serve
from twinct.viewer.show import Show
from twinct.viewer.single_file import export_page


def show_runs(
    folders: Sequence[Path],
    host: str,
    port: int,
    allow_network: bool,
    files: tuple[Path | None, Path | None],
) -> None:
    """Show runs until interrupted, or write one to a page and a film."""
    folders = [folder_of_run(folder) for folder in folders]
    if any(files):
        if len(folders) > 1:
            raise InputError("--export and --movie take one folder")
        show = RunFolder(folders[0]).look()
        _write(show, builder_of(show), *files)
        return
    with suppress(KeyboardInterrupt), serving(host, port, allow_network) as server:
        runs = [RunFolder(folder) for folder in folders]
        live = any(run.under_way for run in runs)
        with ExitStack() as stack:
            page = stack.enter_context(closing(Page(server, len(runs), live=live)))
            for index, run in enumerate(runs):
                show = run.look()
                fill(page, index, show)
                stack.enter_context(closing(FolderPoller(page, index, run, show)))
                for problem in show.problems:
                    say(problem, warning=True)
            stay()


def show_scenario(
    file: Path,
    overrides: Sequence[str],
    host: str,
    port: int,
    allow_network: bool,
    files: tuple[Path | None, Path | None],
) -> None:
    """Show a scenario until interrupted, or write it to a page and a film."""
    builder = SimulationBuilder(load_scenario(file, overrides))
    if any(files):
        with named_places(file, overrides):
            show = planned(builder)
        _write(show, builder, *files)
        return
    with (
        suppress(KeyboardInterrupt),
        serving(host, port, allow_network) as server,
        closing(Page(server)) as page,
    ):
        page.say("planning")
        with named_places(file, overrides):
            show = planned(builder)
        for problem in show.problems:
            say(problem, warning=True)
        page.say("")
        fill(page, 0, show, builder)
        stay()


def design_scenario(scenario: Path, host: str, port: int, allow_network: bool) -> None:
    """Show a scenario with tools to change it, until interrupted."""
    draft = open_draft(scenario)
    with (
        suppress(KeyboardInterrupt),
        serving(host, port, allow_network, files=True) as server,
        temporary_folder() as folder,
        closing(DesignPage(server, draft, folder)),
    ):
        say(f"draft of {draft.path}; the page saves it")
        for problem in draft.problems:
            say(problem, warning=True)
        stay()
    if not draft.is_saved and not draft.unkept:
        say(f"not saved: the draft is kept beside {draft.path}; 'twinct design' goes on with it")


@contextmanager
def serving(host: str, port: int, allow_network: bool, *, files: bool = False) -> Iterator[Server]:
    """Yield a server, and print its address, which is the key to it."""
    server = serve(host, port, allow_network=allow_network, label="twinct", files=files)
    try:
        say(f"page: {address(server)} (Ctrl-C ends it)")
        if is_loopback(host):
            say(f"from another machine: {by_ssh(server)}, then {address(server)} there")
        else:
            say(
                f"--allow-network: whoever knows this address and reaches {host}:"
                f"{server.get_port()} sees the run and can use the controls. Everything, the "
                "address included, crosses the network unencrypted: others there can read it. On "
                f"another machine, write {socket.gethostname()} or an IP address of this machine "
                "as host",
                warning=True,
            )
        yield server
    finally:
        close(server)


@contextmanager
def live_page(
    out: Path, builder: SimulationBuilder, host: str, port: int, allow_network: bool
) -> Iterator[LivePage]:
    """Yield a page that observes a run; it stays until interrupted, unless the run fails."""
    require("view")
    with serving(host, port, allow_network) as server:
        with closing(Page(server, live=True)) as page:
            live = LivePage(page, out, builder)
            yield live
            live.close()
            say("the run has finished; the page stays up until Ctrl-C")
            stay()


def stay() -> None:
    """Wait for Ctrl-C."""
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        return


def _write(
    show: Show, builder: SimulationBuilder | None, export: Path | None, movie: Path | None
) -> None:
    """Write the page, the film, or both."""
    with on_terminal() as audience:
        if export is not None:
            export_page(show, builder, export, audience)
        if movie is not None:
            write_movie(show, builder, movie, audience)
    for path in (export, movie):
        if path is not None:
            say(f"wrote {path}: {path.stat().st_size / 1e6:.1f} MB")
