"""Commands about the robot and policy bundles, and the version."""

from __future__ import annotations

from pathlib import Path


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
    print(f"{'file':16} {path} ({path.stat().st_size / 1e6:.1f} MB)")
    for name in ("name", "layout", "history", "observation_size", "control_hz"):
        print(f"{name:16} {getattr(info, name)}")
    print(f"{'data_hash':16} {info.data_hash}")
    print(f"{'training':16} {info.training}")


def policy_mean(
    *, bundles: tuple[Path, ...], out: Path, shares: tuple[float, ...] = ()
) -> None:
    """Write the mean of the weights of several bundles, often the steadiest of them.

    Args:
        bundles: two or more, e.g. those that one run keeps, or of runs that started
            from one another.
        out: the new bundle.
        shares: of each bundle in the mean; equal by default.
    """
    from openclone.policy.mean import mean_bundle

    mean_bundle(list(bundles), list(shares) or [1.0] * len(bundles), out)
    print(f"policy bundle: {out}")


def version() -> None:
    """Print the version."""
    from importlib.metadata import version as installed

    print(f"openclone {installed('openclone')}")
