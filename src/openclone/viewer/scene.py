"""What stands in the picture: robot, reference ghost, target frames, floor."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import viser
from mjviser import ViserMujocoScene

from openclone.robot.ghost import build_picture_model, visual_mesh
from openclone.robot.model import standing_qpos
from openclone.teleop.messages import KeyPoints

_POINTS = ("head", "left_hand", "right_hand")
_COLOURS = ((242, 140, 26), (51, 191, 77), (204, 64, 153))
_FOLLOW = 0.15
"""Share of the distance to the robot that the picture moves at each update."""
_MESH_CELL = 0.01
"""Metres; coarser than in the film, for browsers without a GPU."""
_GHOST_COLOUR, _GHOST_OPACITY = (38, 140, 242), 0.3


@dataclass
class SceneOptions:
    """What the user wants to see; the panel writes, the scene reads."""

    follow: bool = True
    ghost: bool = True
    targets: bool = True


class RobotScene:
    """The 3D picture of one robot."""

    def __init__(self, server: viser.ViserServer) -> None:
        """Fill ``server``'s scene with a standing robot."""
        self.options = SceneOptions()
        self._server = server
        self._model = build_picture_model(_MESH_CELL)
        self._data = mujoco.MjData(self._model)
        self._ghost_data = mujoco.MjData(self._model)
        self._robot = ViserMujocoScene(server, self._model, num_envs=1)
        # It would follow the pelvis up and down, too; `_follow` keeps the floor level.
        self._robot.camera_tracking_enabled = False
        self._ghost_root = server.scene.add_frame("/ghost", show_axes=False)
        self._ghost = self._add_ghost()
        self._centre = np.zeros(3)
        self._floor = server.scene.add_grid(
            "/floor",
            infinite_grid=True,
            plane_color=(226, 230, 234),
            plane_opacity=1.0,
            cell_color=(205, 210, 216),
            section_color=(160, 168, 178),
            fade_distance=25.0,
            shadow_opacity=0.3,
        )
        self._targets = [self._add_target(index) for index in range(len(_POINTS))]
        server.scene.world_axes.visible = False
        server.initial_camera.position = (2.4, -1.9, 1.5)
        server.initial_camera.look_at = (0.0, 0.0, 0.75)
        server.initial_camera.fov = np.radians(45.0)
        self.update(standing_qpos(), None, None)

    def _add_ghost(self) -> dict[int, viser.MeshHandle]:
        """One translucent mesh per body that has one (mjviser's are opaque)."""
        handles = {}
        for body in range(self._model.nbody):
            vertices, faces = visual_mesh(self._model, body)
            if len(faces):
                handles[body] = self._server.scene.add_mesh_simple(
                    f"/ghost/{self._model.body(body).name}",
                    vertices.astype(np.float32),
                    faces.astype(np.uint32),
                    color=_GHOST_COLOUR,
                    opacity=_GHOST_OPACITY,
                    cast_shadow=False,
                    receive_shadow=False,
                )
        return handles

    def _add_target(self, index: int) -> viser.FrameHandle:
        frame = self._server.scene.add_frame(
            f"/targets/{_POINTS[index]}",
            axes_length=0.12,
            axes_radius=0.005,
            origin_radius=0.001,
        )
        self._server.scene.add_icosphere(
            f"/targets/{_POINTS[index]}/ball", radius=0.022, color=_COLOURS[index]
        )
        return frame

    @property
    def centre(self) -> np.ndarray:
        """(3,), metres, world: the point that stands in the middle of the picture."""
        return self._centre.copy()

    def update(
        self,
        qpos: np.ndarray,
        reference_qpos: np.ndarray | None,
        target: KeyPoints | None,
    ) -> None:
        """Move everything.

        Args:
            qpos: (36,), the robot.
            reference_qpos: (36,), the ghost; None hides it.
            target: head and hands as commanded, world; None hides them.
        """
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        self._follow(qpos[:2])
        with self._server.atomic():
            self._robot.update_from_arrays(
                self._data.xpos[None] - self._centre,
                self._data.xmat.reshape(1, -1, 3, 3),
            )
            self._floor.position = -self._centre
            self._move_ghost(reference_qpos)
            self._move_targets(target)

    def _move_ghost(self, qpos: np.ndarray | None) -> None:
        shown = qpos is not None and self.options.ghost
        self._ghost_root.visible = shown
        if not shown:
            return
        self._ghost_data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._ghost_data)
        self._ghost_root.position = -self._centre
        for body, handle in self._ghost.items():
            handle.position = self._ghost_data.xpos[body]
            handle.wxyz = self._ghost_data.xquat[body]

    def _move_targets(self, target: KeyPoints | None) -> None:
        shown = target is not None and self.options.targets
        for index, frame in enumerate(self._targets):
            frame.visible = shown
            if shown:
                assert target is not None
                frame.position = target.position[index] - self._centre
                frame.wxyz = target.quat[index]

    def _follow(self, robot_xy: np.ndarray) -> None:
        """Let the picture's centre glide after the robot, or stay at the origin."""
        goal = robot_xy if self.options.follow else np.zeros(2)
        self._centre[:2] += _FOLLOW * (goal - self._centre[:2])
