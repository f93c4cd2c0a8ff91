"""Help of arguments that need no value: tyro would say that their default is None, or nothing."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, signature
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

import tyro

Command = TypeVar("Command", bound=Callable[..., Any])
_OPTIONAL, _REQUIRED = (
    tyro.conf.arg(help_behavior_hint=f"({word})") for word in ("optional", "required")
)


def mark_optional(command: Command) -> Command:
    """Mark arguments of a command, or of a group of arguments, as optional in its help.

    An argument that states its own hint keeps it. Lists without default value are required.
    """
    hints = get_type_hints(command, include_extras=True)
    for name, parameter in signature(command).parameters.items():
        kept, default = hints[name], parameter.default
        base, *facts = get_args(kept) if get_origin(kept) is Annotated else (kept,)
        if tyro.conf.UseAppendAction in facts:  # tyro calls it repeatable
            continue
        if default in (None, (), ""):
            hints[name] = Annotated[(base, _OPTIONAL, *facts)]
        elif default is Parameter.empty and get_origin(base) is tuple:
            hints[name] = Annotated[(base, _REQUIRED, *facts)]
    command.__annotations__ = hints
    return command
