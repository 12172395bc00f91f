"""The command `openclone`: a table of thin functions over the rooms.

Nothing heavy is imported before a command is chosen, so that ``openclone --help``
answers at once. The signature of each function is its command line: keyword-only
parameters become options, positional-only ones become arguments.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

from openclone.errors import InputError, OpenCloneError


def robot_joints(name: str | None = None, /) -> None:
    """Print the G1's joints (or one): limits, standing angle, motor, gains, sources."""
    from openclone.robot import g1

    chosen = range(g1.NUM_JOINTS) if name is None else [g1.joint_index(name)]
    print("no joint                          lower    upper  default", end=" ")
    print(" N m rad/s  N m/rad N m s/rad")
    for index in chosen:
        joint = g1.JOINTS[index]
        motor = joint.motor
        print(
            f"{index:2d} {joint.name:27} {joint.lower:8.4f} {joint.upper:8.4f} "
            f"{joint.default:8.2f} {motor.max_torque:4.0f} {motor.max_speed:5.0f} "
            f"{motor.kp:8.2f} {motor.kd:9.2f}"
        )
    print("sources:", " ".join((g1.__doc__ or "").partition("Sources: ")[2].split()))


def policy_info(bundle: Path | None = None, /) -> None:
    """Print what a policy bundle (default: the packaged one) was trained for."""
    from openclone.policy.bundle import load_bundle, packaged_bundle

    path = bundle or packaged_bundle()
    info = load_bundle(path).info
    print(f"file         {path} ({path.stat().st_size / 1e6:.1f} MB)")
    for name in ("name", "layout", "history", "observation_size", "control_hz"):
        print(f"{name:12} {getattr(info, name)}")
    print(f"{'data_hash':12} {info.data_hash}")
    print(f"{'training':12} {info.training}")


def version() -> None:
    """Print the version."""
    from importlib.metadata import version as installed

    print(f"openclone {installed('openclone')}")


COMMANDS: dict[str, Callable[..., None]] = {
    "robot joints": robot_joints,
    "policy info": policy_info,
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


if __name__ == "__main__":
    sys.exit(main())
