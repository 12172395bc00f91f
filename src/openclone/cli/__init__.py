"""The command `openclone`: a table of thin functions over the rooms.

Nothing heavy is imported before a command is chosen, so that ``openclone --help``
answers at once. The signature of each function is its command line: keyword-only
parameters become options, positional-only ones become arguments.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

from openclone.cli.curation import motions_build, motions_inspect
from openclone.cli.editing import motions_augment, motions_edit
from openclone.cli.facts import policy_info, policy_mean, robot_joints, version
from openclone.cli.learning import (
    train_model,
    train_plan,
    train_student,
    train_teacher,
)
from openclone.cli.measuring import (
    evaluate_odometry,
    evaluate_pushes,
    evaluate_squat,
    evaluate_standing,
    evaluate_tracking,
)
from openclone.cli.motions import (
    motions_export,
    motions_import,
    motions_retarget,
    motions_synthesize,
)
from openclone.cli.odometry import odometry_run, odometry_simulate
from openclone.cli.running import demo, teleop, view
from openclone.errors import InputError, OpenCloneError

COMMANDS: dict[str, Callable[..., None]] = {
    "demo": demo,
    "teleop": teleop,
    "view": view,
    "evaluate tracking": evaluate_tracking,
    "evaluate standing": evaluate_standing,
    "evaluate squat": evaluate_squat,
    "evaluate pushes": evaluate_pushes,
    "evaluate odometry": evaluate_odometry,
    "train teacher": train_teacher,
    "train student": train_student,
    "train model": train_model,
    "train plan": train_plan,
    "motions synthesize": motions_synthesize,
    "motions retarget": motions_retarget,
    "motions edit": motions_edit,
    "motions augment": motions_augment,
    "motions build": motions_build,
    "motions inspect": motions_inspect,
    "motions export": motions_export,
    "motions import": motions_import,
    "odometry run": odometry_run,
    "odometry simulate": odometry_simulate,
    "policy info": policy_info,
    "policy mean": policy_mean,
    "robot joints": robot_joints,
    "version": version,
}


def usage(group: str = "") -> str:
    """The table of commands, or of those whose first word is ``group``."""
    lines = ["usage: openclone COMMAND [OPTIONS]", ""]
    for name, function in COMMANDS.items():
        if not group or name.split()[0] == group:
            summary = (function.__doc__ or "").strip().splitlines()[0]
            lines.append(f"  {name:20} {summary}")
    return "\n".join([*lines, "", "`openclone COMMAND --help` explains its options."])


def find_command(words: list[str]) -> tuple[str, list[str]]:
    """Split the command line into a command's name and its arguments.

    Raises:
        InputError: no such command.
    """
    for count in (2, 1):
        name = " ".join(words[:count])
        if len(words) >= count and name in COMMANDS:
            return name, words[count:]
    known = [name for name in COMMANDS if name.split()[0] == words[0]]
    what = f"unknown command {' '.join(words[: 2 if known else 1])!r}"
    remedy = f"use {', '.join(known)}" if known else "`openclone --help` lists them"
    raise InputError(what, remedy=remedy)


def run(words: list[str]) -> None:
    """Run the command line ``words``."""
    if not words or words[0] in ("-h", "--help", "help"):
        print(usage())
        return
    groups = {name.split()[0] for name in COMMANDS if " " in name}
    if words[0] in groups and set(words[1:]) & {"-h", "--help"} == set(words[1:]):
        print(usage(words[0]))
        return
    if words == ["--version"]:
        words = ["version"]
    name, rest = find_command(words)
    import tyro

    tyro.cli(COMMANDS[name], args=rest, prog=f"openclone {name}")


def main() -> int:
    """Entry point; returns the exit code."""
    try:
        run(sys.argv[1:])
    except OpenCloneError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of a pipe (such as `head`) has gone; nobody is left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    return 0
