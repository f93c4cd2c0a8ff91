"""Options and arguments of commands as tyro shows them in the help, and as they are read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import Parameter, signature
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import tyro

from twinct.cli.values import read_here

Command = TypeVar("Command", bound=Callable[..., Any])
_OPTIONAL, _REQUIRED = (
    tyro.conf.arg(help_behavior_hint=f"({word})") for word in ("optional", "required")
)


def mark_optional(
    command: Command, group: str = "", facts: Mapping[str, Any] | None = None
) -> Command:
    """Mark arguments of a command, or of a group of arguments, as optional in its help.

    Otherwise tyro would say that their default is None, or nothing. An argument that states its own
    hint keeps it. Lists without default value are required. Wrong values are refused by name
    (``twinct.cli.values``).

    Args:
        command: function, or class of a group.
        group: what stands before the names of the group's options, such as ``arms.``.
        facts: arguments as tyro shows them, by name, besides what their types state.
    """
    hints = get_type_hints(command, include_extras=True)
    for name, parameter in signature(command).parameters.items():
        hint, default = hints[name], parameter.default
        base, *known = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        known += [facts[name]] if facts and name in facts else []
        if tyro.conf.UseAppendAction in known:  # tyro calls it repeatable
            continue
        option = f"--{group}{name.strip('_').replace('_', '-')}"
        read = read_here(base, name if tyro.conf.Positional in known else option)
        if default in (None, (), ""):
            known = [_OPTIONAL, *known]
        elif default is Parameter.empty and get_origin(base) is tuple:
            known = [_REQUIRED, *known]
        hints[name] = Annotated[(read, *known)] if known else read
    command.__annotations__ = hints
    return command
