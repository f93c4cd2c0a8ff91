"""The command ``twinct view``: the page of a run or a scenario."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from twinct.cli.progress import on_terminal, say
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.writing import check_film, check_page
from twinct.core.foreign_text import counted
from twinct.scenario import load_scenario, named_places
from twinct.viewer.locate import folder_of_run

if TYPE_CHECKING:
    from twinct.scan import SimulationBuilder
    from twinct.viewer.following import LivePage
    from twinct.viewer.server import Server
    from twinct.viewer.show import Show

MOST_RUNS = 2


def view_command(
    targets: Sequence[Path],
    host: str,
    port: int,
    allow_network: bool,
    export: Path | None,
    movie: Path | None,
    set_: Sequence[str],
) -> None:
    """Show runs or a scenario until interrupted, or write them to files."""
    if not 1 <= len(targets) <= MOST_RUNS:
        raise InputError(
            f"{counted(len(targets), 'folder')}: the page shows one, or two side by side"
        )
    if export is not None:
        check_page(export, "--export")
    if movie is not None:
        check_film(movie, "--movie")
    require("view", "robots")
    if len(targets) == 1 and not targets[0].is_dir():
        server = partial(serving, host, port, allow_network)
        _view_scenario(targets[0], server, (export, movie), set_)
        return
    if set_:
        raise InputError(f"--set {set_[0]}: only a scenario takes --set; a run is shown as it is")
    folders = [folder_of_run(target) for target in targets]
    if export is not None or movie is not None:
        if len(folders) > 1:
            raise InputError("--export and --movie take one folder")
        from twinct.scan import SimulationBuilder
        from twinct.viewer.run_folder import RunFolder

        show = RunFolder(folders[0]).look()
        _write(show, SimulationBuilder(show.scenario, show.plan), export, movie)
        return
    # A browser loads the page while the modules that read the run are imported.
    with suppress(KeyboardInterrupt), serving(host, port, allow_network) as server:
        from twinct.viewer.filling import fill
        from twinct.viewer.following import FolderPoller
        from twinct.viewer.live_page import Page
        from twinct.viewer.run_folder import RunFolder

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
            _stay()


def _view_scenario(
    file: Path,
    served: Callable[[], AbstractContextManager[Server]],
    files: tuple[Path | None, Path | None],
    set_: Sequence[str],
) -> None:
    from twinct.scan import SimulationBuilder
    from twinct.viewer.filling import fill
    from twinct.viewer.live_page import Page
    from twinct.viewer.planned import planned

    builder = SimulationBuilder(load_scenario(file, set_))
    if any(files):
        with named_places(file, set_):
            show = planned(builder)
        _write(show, builder, *files)
        return
    with (
        suppress(KeyboardInterrupt),
        served() as server,
        closing(Page(server)) as page,
    ):
        page.say("planning")
        with named_places(file, set_):
            show = planned(builder)
        for problem in show.problems:
            say(problem, warning=True)
        page.say("")
        fill(page, 0, show, builder)
        _stay()


@contextmanager
def serving(host: str, port: int, allow_network: bool) -> Iterator[Server]:
    """Yield a server, and print its address, which is the key to it."""
    from twinct.viewer.server import address, by_ssh, close, is_loopback, serve

    server = serve(host, port, allow_network=allow_network, label="twinct")
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
    from twinct.viewer.following import LivePage
    from twinct.viewer.live_page import Page

    with serving(host, port, allow_network) as server:
        with closing(Page(server, live=True)) as page:
            live = LivePage(page, out, builder)
            yield live
            live.close()
            say("the run has finished; the page stays up until Ctrl-C")
            _stay()


def _stay() -> None:
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        return


def _write(show: Show, builder: SimulationBuilder, export: Path | None, movie: Path | None) -> None:
    """Write the page, the film, or both."""
    with on_terminal() as audience:
        if export is not None:
            from twinct.viewer.single_file import export_page

            export_page(show, builder, export, audience)
        if movie is not None:
            from twinct.viewer.movie import write_movie

            write_movie(show, builder, movie, audience)
    for path in (export, movie):
        if path is not None:
            say(f"wrote {path}: {path.stat().st_size / 1e6:.1f} MB")
