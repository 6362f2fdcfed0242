"""One verb for several of a kind: `ruffini VERB WHAT`, with the options of all of them and one page of help."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Mapping
from typing import Annotated, Any, get_args, get_origin

import typer
from typer.core import TyperCommand
from typer.models import ArgumentInfo, OptionInfo

Function = Callable[..., None]
GIVEN = ("COMMANDLINE", "ENVIRONMENT")


def register(
    app: typer.Typer,
    name: str,
    text: str,
    functions: Mapping[str, Function],
    old: Mapping[str, Function] | None = None,
    **how: Any,
) -> None:
    """Make `app`'s verb `name`, which calls the function that its first argument names; help does not show `old`."""
    shown, functions = functions, {**functions, **(old or {})}
    parameters = {what: _parameters(function) for what, function in functions.items()}
    options = [_argument("what", str, "WHAT", ", ".join(shown), inspect.Parameter.empty)]
    if any(isinstance(info, ArgumentInfo) for one in parameters.values() for _, info, _ in one.values()):
        options.append(_argument("names", list[str] | None, "NAME...", _names(shown), None))
    texts: dict[str, dict[str, list[str]]] = {}  # of each option its texts, each with those that it is of
    declared: dict[str, tuple[Any, OptionInfo]] = {}
    for what, one in parameters.items():
        for option, (kind, info, _) in one.items():
            if isinstance(info, OptionInfo):
                if declared.setdefault(option, (kind, info))[0] != kind:
                    raise TypeError(f"{name} {what}: {option} is of another type elsewhere: give it a verb of its own")
                if what in shown:
                    texts.setdefault(option, {}).setdefault(info.help or "", []).append(what)
    for option, (kind, first) in declared.items():
        info = copy.copy(first)
        info.hidden = option not in texts
        if texts.get(option) != {first.help or "": list(shown)}:
            info.help = " ".join(f"{', '.join(of)}: {said}" for said, of in texts.get(option, {}).items())
        default, annotation = (False, kind) if kind is bool else (None, kind | None)
        options.append(_parameter(option, Annotated[annotation, info], default))

    class OneOf(TyperCommand):
        """A verb that refuses what the chosen one has no use for, and asks for what it needs."""

        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            rest: list[str] = super().parse_args(ctx, args)
            if not ctx.resilient_parsing:
                try:
                    ctx.meta["ruffini.call"] = _call(functions, ctx)
                except LookupError as missing:  # as where it is the verb's own, and always needed
                    # A copy: the next call may be for one that does not need it.
                    parameter = copy.copy(next(p for p in self.params if p.name == missing.args[0]))
                    parameter.required, parameter.metavar = True, missing.args[1]
                    parameter.process_value(ctx, None)
                except ValueError as error:
                    ctx.fail(f"{name} {ctx.params['what']}: {error}")
            return rest

    def run(ctx: typer.Context, **_: Any) -> None:
        function, values = ctx.meta["ruffini.call"]
        function(**values)

    every = [_parameter("ctx", typer.Context, inspect.Parameter.empty), *options]
    run.__signature__ = inspect.Signature(every)  # type: ignore[attr-defined]
    run.__annotations__ = {p.name: p.annotation for p in every}
    lines = [f"{what}: {(function.__doc__ or '').strip()}" for what, function in shown.items()]
    app.command(name, cls=OneOf, help="\n\n".join([text, *lines]), short_help=f"{text} ({', '.join(shown)})",
                no_args_is_help=True, **how)(run)  # fmt: skip


def _parameter(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _argument(name: str, kind: Any, metavar: str, text: str, default: Any) -> inspect.Parameter:
    return _parameter(name, Annotated[kind, typer.Argument(metavar=metavar, help=text)], default)


def _parameters(function: Function) -> dict[str, tuple[Any, OptionInfo | ArgumentInfo, Any]]:
    """Type without None, Typer's declaration and default of each parameter."""
    found = {}
    for name, parameter in inspect.signature(function, eval_str=True).parameters.items():
        kind, info = get_args(parameter.annotation)[:2]
        kinds = [one for one in get_args(kind) if one is not type(None)]
        is_optional = type(None) in get_args(kind) and get_origin(kind) is not list
        found[name] = (kinds[0] if is_optional and len(kinds) == 1 else kind, info, parameter.default)
    return found


def _names(functions: Mapping[str, Function]) -> str:
    """What the arguments after WHAT are."""
    lists = {
        what: " ".join(info.metavar or name.upper() for name, (_, info, _) in _parameters(function).items()
                       if isinstance(info, ArgumentInfo))
        for what, function in functions.items()
    }  # fmt: skip
    return "; ".join(f"{what}: {names}" for what, names in lists.items() if names)


def _call(functions: Mapping[str, Function], ctx: Any) -> tuple[Function, dict[str, Any]]:
    """The function and its arguments. Raises ValueError with the reason where they do not fit,
    LookupError where one is missing.
    """
    if ctx.params["what"] not in functions:
        raise ValueError(f"there is no such one: choose one of {', '.join(functions)}")
    function = functions[ctx.params["what"]]
    wanted = _parameters(function)
    given = {k for k in ctx.params if getattr(ctx.get_parameter_source(k), "name", "") in GIVEN} - {"what", "names"}
    flags = {p.name: p.opts[-1] for p in ctx.command.params if p.opts}
    for name in given - wanted.keys():
        raise ValueError(f"it has no option {flags[name]}: leave it out")
    values = {name: ctx.params[name] for name in given}
    names = list(ctx.params.get("names") or [])
    for name, (kind, info, default) in wanted.items():
        if isinstance(info, ArgumentInfo):
            if get_origin(kind) is list and names:
                values[name], names = [get_args(kind)[0](one) for one in names], []
            elif names:
                values[name] = kind(names.pop(0))
        if name not in values and default is inspect.Parameter.empty:
            is_name = isinstance(info, ArgumentInfo)
            raise LookupError("names" if is_name else name, (info.metavar or name.upper()) if is_name else None)
    if names:
        raise ValueError(f"nothing takes {names[0]!r}: leave it out")
    return function, values
