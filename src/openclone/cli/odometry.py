"""Commands on LiDAR odometry alone: odometry run, odometry simulate."""

from __future__ import annotations

from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from openclone.cli.options import positive, print_figures, write_figures
from openclone.errors import InputError

if TYPE_CHECKING:
    from openclone.odometry.protocol import SensorOdometry
    from openclone.odometry.replay import Replay


def make_odometry(kind: Literal["lio", "rko"]) -> SensorOdometry:
    """Fresh odometry with its default settings, for a Mid-360."""
    if kind == "rko":
        from openclone.odometry.rko import RkoLio

        return RkoLio()
    from openclone.odometry.fast_lio import FastLio
    from openclone.odometry.warmup import warm_up

    warm_up()
    return FastLio()


def odometry_run(
    file: Path,
    /,
    *,
    out: Path,
    odometry: Literal["lio", "rko"] = "lio",
    imu_topic: str = "",
    lidar_topic: str = "",
    reference_topic: str = "/ground_truth",
    imu_unit: Literal["auto", "g", "m/s2"] = "auto",
    json: Path | None = None,
) -> None:
    """Estimate the path of a recorded LiDAR and IMU: a TUM trajectory and a plot.

    Args:
        file: MCAP recording, or a ROS 2 bag (folder or .db3) with sensor_msgs/Imu and
            PointCloud2 or Livox CustomMsg.
        out: folder for trajectory.tum, trajectory.png, and reference.tum if the file
            holds a reference.
        odometry: lio is FAST-LIO2, rko is rko_lio.
        imu_topic: found by its type by default.
        lidar_topic: found by its type by default.
        reference_topic: nav_msgs/Odometry to compare with, if it is in the file.
        imu_unit: of the accelerations; found by their size by default.
        json: write the figures to this file.
    """
    from openclone.odometry.recording import Topics, read_samples
    from openclone.odometry.replay import Replay, replay

    topics = Topics(imu_topic, lidar_topic, reference_topic)
    samples = read_samples(file, topics=topics, unit=imu_unit)
    # A file of another kind is refused before anything is compiled.
    first = list(islice(samples, 1))
    result = Replay()
    engine = make_odometry(odometry)
    try:
        replay(chain(first, samples), engine, result, _print_progress)
    except InputError as error:
        if result.tracked == 0:
            raise
        _write_results(result, odometry, file, out, json)
        raise InputError(f"{error}; what came before is in {out}") from error
    _write_results(result, odometry, file, out, json)


def _print_progress(result: Replay, stamp_ns: int) -> None:
    if result.scans % 100 == 0:
        print(f"{result.scans} scans, {result.tracked} tracked", flush=True)


def _write_results(
    result: Replay, odometry: str, file: Path, out: Path, json: Path | None
) -> None:
    """TUM files, the plot and the figures of a finished replay."""
    import numpy as np

    from openclone.evaluation.trajectory_plot import trajectory_picture
    from openclone.odometry.trajectory import compare, write_tum

    path, reference = result.trajectory, result.reference
    if not len(path):
        why = f"; first refusal: {result.first_refusal}" if result.refused else ""
        raise InputError(
            f"the odometry tracked none of the {result.scans} scans{why}",
            where=str(file),
            remedy="begin a recording with one second at rest",
        )
    write_tum(path, out / "trajectory.tum")
    title = f"{file.name}, {odometry}"
    known = reference if len(reference) else None
    (out / "trajectory.png").write_bytes(trajectory_picture(path, known, title))
    steps = np.linalg.norm(np.diff(path.positions, axis=0), axis=1)
    figures: dict[str, object] = {
        "scans": result.scans,
        "tracked": result.tracked,
        "refused": result.refused,
        "seconds": float(path.stamps_ns[-1] - path.stamps_ns[0]) * 1e-9,
        "path_m": float(steps.sum()),
        "cpu_ms_mean": float(np.mean(result.scan_cpu_s)) * 1e3,
        "cpu_ms_p99": float(np.percentile(result.scan_cpu_s, 99)) * 1e3,
    }
    if known is not None:
        write_tum(known, out / "reference.tum")
        error = compare(path, known)
        figures["ate_cm"] = error.ate_rmse_m * 100
        figures["ate_max_cm"] = error.ate_max_m * 100
        figures["heading_max_deg"] = error.heading_max_deg
    print_figures(figures)
    if result.refused:
        print(f"first refusal: {result.first_refusal}")
    print(f"trajectory: {out / 'trajectory.tum'}, plot: {out / 'trajectory.png'}")
    write_figures(json, figures)


def odometry_simulate(
    *,
    out: Path,
    world: str = "room",
    seconds: float = 60.0,
    policy: Path | None = None,
    seed: int = 0,
    json: Path | None = None,
) -> None:
    """Record the LiDAR and IMU of the simulated robot walking, with the truth.

    Args:
        out: the MCAP file to write; `odometry run` and Foxglove open it.
        world: flat, room, corridor, hall, glass or people.
        seconds: simulated time of the walk; 2 MB of file per second.
        policy: policy bundle; the packaged student by default.
        seed: of the sensors' errors.
        json: write the figures to this file.
    """
    from dataclasses import asdict

    from openclone.evaluation.sensor_recording import record_walk
    from openclone.policy.bundle import load_bundle

    positive("--seconds", seconds)

    def progress(scans: int) -> None:
        if scans % 100 == 0:
            print(f"{scans} scans", flush=True)

    walk = record_walk(
        out,
        load_bundle(policy),
        world=world,
        seconds=seconds,
        seed=seed,
        progress=progress,
    )
    figures = asdict(walk)
    print_figures(figures)
    print(f"recording: {out}, {out.stat().st_size / 1e6:.0f} MB")
    write_figures(json, figures)
