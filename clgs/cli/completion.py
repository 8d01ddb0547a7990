"""Scripts by which shells complete the commands, options and their values of ``clgs``."""

from __future__ import annotations

import argparse
from typing import Any

SHELLS = ("bash", "zsh", "fish")

BASH = """\
_clgs() {{
    local current=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} words= values=
    case "$COMP_CWORD:${{COMP_WORDS[1]}}" in
    1:*) words="{commands}" ;;
{cases}
    esac
    case "${{COMP_WORDS[1]}}:$before" in
{values}
    esac
    COMPREPLY=()
    if [[ -n $values ]]; then
        COMPREPLY=($(compgen -W "$values" -- "$current"))
    elif [[ $COMP_CWORD == 1 || $current == -* ]]; then
        COMPREPLY=($(compgen -W "$words" -- "$current"))
    fi
}}
complete -o default -F _clgs clgs
"""
ZSH = "autoload -U +X compinit bashcompinit && compinit && bashcompinit\n"


class Completion(argparse.Action):
    """``--completion SHELL``: print the script and end."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Print the script for the shell that ``values`` names; exits with code 0."""
        print(script(parser, values), end="")
        parser.exit(0)


def script(parser: argparse.ArgumentParser, shell: str) -> str:
    """The script for one of SHELLS."""
    options, values = options_by_command(parser), values_by_command(parser)
    if shell == "fish":
        return _fish(options, values)
    cases = (f'    *:{name}) words="{" ".join(words)}" ;;' for name, words in options.items())
    known = (
        f'    {name}:{option}) values="{" ".join(words)}" ;;'
        for name, allowed in values.items()
        for option, words in allowed.items()
    )
    text = BASH.format(commands=" ".join(options), cases="\n".join(cases), values="\n".join(known))
    return ZSH + text if shell == "zsh" else text


def options_by_command(parser: argparse.ArgumentParser) -> dict[str, list[str]]:
    """The long options of every command, and those of the kinds below it."""
    return {name: sorted(set(_long_options(one))) for name, one in _commands(parser).items()}


def values_by_command(parser: argparse.ArgumentParser) -> dict[str, dict[str, list[str]]]:
    """What may follow the options of every command that take one of a few words."""
    return {name: _allowed(one) for name, one in _commands(parser).items()}


def _commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    found = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return next((dict(action.choices) for action in found), {})


def _long_options(parser: argparse.ArgumentParser) -> list[str]:
    own = [word for a in parser._actions for word in a.option_strings if word.startswith("--")]
    return own + [word for one in _commands(parser).values() for word in _long_options(one)]


def _allowed(parser: argparse.ArgumentParser) -> dict[str, list[str]]:
    own = {
        word: [str(value) for value in action.choices]
        for action in parser._actions
        if action.choices and action.option_strings
        for word in action.option_strings
        if word.startswith("--")
    }
    below = (_allowed(one) for one in _commands(parser).values())
    return own | {option: words for one in below for option, words in one.items()}


def _fish(options: dict[str, list[str]], values: dict[str, dict[str, list[str]]]) -> str:
    lines = [f'complete -c clgs -n __fish_use_subcommand -f -a "{" ".join(options)}"']
    for name, words in options.items():
        seen = f"complete -c clgs -n '__fish_seen_subcommand_from {name}'"
        for word in words:
            allowed = values[name].get(word)
            after = f' -x -a "{" ".join(allowed)}"' if allowed else ""
            lines.append(f"{seen} -l {word.removeprefix('--')}{after}")
    return "\n".join(lines) + "\n"
