"""Scenario -> everything placed in one world, and the pose of every object at any t."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sim import meshes, traffic
from sim.camera import Camera, StereoRig
from sim.kitti import LabelTrack, read_poses, read_track, read_tracks
from sim.model import Model, VehicleModel
from sim.pose import Pose, exp_so3, vehicle_rotation
from sim.realism.passing import Driver, passing_cars
from sim.replay import Replay, plan, visit
from sim.roadside import Path, build_roadside, follow
from sim.scenario import Ego, Labels, Rig, Scenario, ScenarioError, Vehicle, nearest
from sim.streams import stream
from sim.trajectory import Trajectory

Array = np.ndarray

# KITTI object types that can be replayed, and the mesh each becomes; cars are told apart by their length.
_MESH_OF_LABEL = {"Van": "van", "Truck": "lorry", "Tram": "bus", "Bus": "bus", "Misc": "van"}
# How far the street goes on behind the first and beyond the last place of the ego car.
_BEHIND_M, _AHEAD_M = 40.0, 160.0
_LINE_STEP_M = 1.0


@dataclass(frozen=True, eq=False)
class Actor:
    """A vehicle with its motion; occlusion (m,) of a replayed label per frame (0..3, -1 not seen), or None."""

    name: str
    model: VehicleModel
    trajectory: Trajectory
    occlusion: Int[Array, "m"] | None = None

    @property
    def reference_v(self) -> Float[Array, "3"]:
        """Middle of the rear axle, system F of Siegemund 2008, 3.8."""
        return np.array([0.0, 0.0, self.model.wheel_radius_m])


@dataclass(frozen=True, eq=False)
class Prop:
    """A thing that stands still."""

    name: str
    model: Model
    T_wb: Pose


@dataclass(frozen=True, eq=False)
class World:
    """t_s (m,) frame times; the true and the nominal rig; the ego car's ground point below the left camera as a
    trajectory and T_ec the camera on it; all vehicles, ``actors[target]`` the observed one; what stands still."""

    t_s: Float[Array, "m"]
    rig: StereoRig
    nominal_rig: StereoRig
    ego: Trajectory
    T_ec: Pose
    ego_moves: bool
    actors: tuple[Actor, ...]
    target: int
    props: tuple[Prop, ...]

    def T_wc(self, t: float | Array) -> Pose:
        """Pose of the left camera in the world."""
        return self.ego.pose(t) @ self.T_ec


def make_rig(rig: Rig) -> tuple[StereoRig, StereoRig]:
    """The true and the nominal stereo rig."""

    def build(focal_px: float, baseline_m: float, rotation_deg: tuple[float, float, float]) -> StereoRig:
        camera = Camera.simple(rig.size_px, focal_px, rig.principal_px)
        camera = Camera(camera.K, rig.size_px, np.array(rig.distortion, float))
        if not np.isfinite(camera.normalise(_grid(rig.size_px))).all():
            raise ScenarioError(f"rig.distortion: {list(rig.distortion)} folds the image before its corners")
        R_rl = exp_so3(-np.deg2rad(rotation_deg))
        return StereoRig(camera, camera, Pose(R_rl, -R_rl @ np.array([baseline_m, 0.0, 0.0])))

    true = build(rig.focal_px, rig.baseline_m, rig.right_rotation_deg)
    n = rig.nominal
    if n.focal_px is None and n.baseline_m is None and n.right_rotation_deg is None:
        return true, true
    rotation = rig.right_rotation_deg if n.right_rotation_deg is None else n.right_rotation_deg
    return true, build(n.focal_px or rig.focal_px, n.baseline_m or rig.baseline_m, rotation)


def _grid(size_px: tuple[int, int]) -> Float[Array, "5 5 2"]:
    """Pixels over the whole image with its corners."""
    return np.stack(np.meshgrid(*(np.linspace(-0.5, n - 0.5, 5) for n in size_px)), axis=-1)


def camera_mount(rig: Rig) -> Pose:
    """T_ec: left camera on the ego frame e (x forward, y left, z up, on the ground below the camera)."""
    R_level = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    pitch = exp_so3(np.array([np.deg2rad(rig.pitch_deg), 0.0, 0.0]))
    return Pose(R_level @ pitch, np.array([0.0, 0.0, rig.height_m]))


def build_world(scenario: Scenario) -> World:
    """Places everything; the looks follow from the scenario's seed alone.

    Raises
        ScenarioError: a file is missing or broken, a track id is not there, or two vehicles would touch.
    """
    target = scenario.target
    label = _label(target, scenario.target_index)
    model = _model(target, scenario, label)
    replay = None if label is None else _replay(target, label, model, scenario.ego)
    t_s = _frame_times(scenario.rig, replay)
    end_s = float(t_s[-1])
    actors = []
    for v in scenario.vehicle:
        if v is target:
            motion = traffic.trajectory(v.motion, end_s) if replay is None else replay.target
            seen = None if replay is None else _label_occlusion(v, replay, t_s)
            actors.append(Actor(v.name, model, motion, seen))
        else:
            actors.append(Actor(v.name, _model(v, scenario, None), traffic.trajectory(v.motion, end_s)))
    _refuse_contact(actors, t_s)
    ego = _ego(scenario.ego, replay, end_s)
    rig, nominal = make_rig(scenario.rig)
    T_wc = ego.pose(t_s) @ camera_mount(scenario.rig)
    actors += _passing(scenario, actors, T_wc, t_s)
    actors += _traffic(scenario, label)
    moves = scenario.ego.motion is not None or scenario.ego.poses is not None
    props = _props(scenario, actors, ego, t_s) if scenario.world.roadside else ()
    return World(t_s, rig, nominal, ego, camera_mount(scenario.rig), moves, tuple(actors), scenario.target_index, props)


def _frame_times(rig: Rig, replay: Replay | None) -> Array:
    frames = rig.frames
    if replay is not None:
        available = int(np.floor(replay.end_s * rig.rate_hz + 1e-6)) + 1
        if frames is not None and frames > available:
            raise ScenarioError(f"rig.frames: {frames} frames asked for, but the label lasts for {available}")
        frames = frames or available
    return np.arange(frames or 1) / rig.rate_hz


def _label(vehicle: Vehicle, index: int) -> LabelTrack | None:
    if not isinstance(vehicle.motion, Labels):
        return None
    return read_track(vehicle.motion.labels, vehicle.motion.track, f"vehicle.{index}.motion")


def _replay(vehicle: Vehicle, label: LabelTrack, model: VehicleModel, ego: Ego) -> Replay:
    assert isinstance(vehicle.motion, Labels)
    motion = vehicle.motion
    camera = None if ego.poses is None else read_poses(ego.poses)
    middle = model.size_m[0] / 2 - model.rear_overhang_m
    try:
        return plan(label, camera, middle, motion.label_rate_hz, motion.smoothing_m, np.deg2rad(motion.smoothing_deg))
    except ValueError as error:
        raise ScenarioError(f"ego.poses: {ego.poses}: {error}") from error


def _label_occlusion(vehicle: Vehicle, replay: Replay, t_s: Array) -> Int[Array, "m"]:
    """The label's occlusion; where its causes are in the world, only whether it was seen at all."""
    assert isinstance(vehicle.motion, Labels)
    level = replay.occlusion(t_s)
    return np.minimum(level, 0) if vehicle.motion.traffic else level


def _traffic(scenario: Scenario, label: LabelTrack | None) -> list[Actor]:
    """The other vehicles of the target's label file, each while it is labelled; they may touch, as labels do."""
    motion, poses = scenario.target.motion, scenario.ego.poses
    if label is None or not isinstance(motion, Labels) or not motion.traffic:
        return []
    camera = None if poses is None else read_poses(poses)
    found = []
    for number, other in read_tracks(motion.labels).items():
        if number == motion.track or other.kind not in ("Car", *_MESH_OF_LABEL):
            continue
        name = f"track {number}"
        rng = stream(scenario.seed, 0, f"{name}/mesh")
        model = meshes.make_vehicle(_label_mesh(other), rng, other.size_m)
        smoothing = motion.label_rate_hz, motion.smoothing_m, np.deg2rad(motion.smoothing_deg)
        try:
            there = visit(other, label, camera, model.size_m[0] / 2 - model.rear_overhang_m, *smoothing)
        except ValueError as error:
            raise ScenarioError(f"ego.poses: {poses}: {error}") from error
        if there is not None:
            found.append(Actor(name, model, there))
    return found


def _label_mesh(label: LabelTrack) -> str:
    """The built-in kind that a KITTI type and length stand for."""
    if label.kind == "Car":
        return "hatchback" if label.size_m[0] < 3.9 else "sedan" if label.size_m[0] < 4.6 else "estate"
    if label.kind not in _MESH_OF_LABEL:
        allowed = ", ".join(["Car", *_MESH_OF_LABEL])
        raise ScenarioError(f"labels: the track is a {label.kind}, which is no vehicle; allowed: {allowed}")
    return _MESH_OF_LABEL[label.kind]


def _model(vehicle: Vehicle, scenario: Scenario, label: LabelTrack | None) -> VehicleModel:
    key = f"vehicle.{scenario.vehicle.index(vehicle)}.mesh"
    rng = stream(scenario.seed, 0, f"{vehicle.name}/mesh")
    mesh, size = vehicle.mesh, vehicle.size_m
    if mesh == "label":
        if label is None:
            raise ScenarioError(f"{key}: 'label' needs a motion of kind 'labels'")
        mesh, size = _label_mesh(label), size or label.size_m
    if mesh in meshes.VEHICLE_KINDS:
        return meshes.make_vehicle(mesh, rng, size, vehicle.color)
    if mesh == "point_grid":
        return meshes.point_grid(size or (5.0, 1.25, 1.0), vehicle.grid)
    if not vehicle.is_file:
        raise ScenarioError(f"{key}: found {mesh!r}, {nearest(mesh, [*meshes.VEHICLE_KINDS, 'point_grid', 'label'])}")
    try:
        return meshes.load_mesh(
            pathlib.Path(mesh), size_m=size, forward=vehicle.forward, up=vehicle.up, color=vehicle.color
        )
    except ValueError as error:
        raise ScenarioError(f"{key}: {error}") from error


def _ego(ego: Ego, replay: Replay | None, end_s: float) -> Trajectory:
    if ego.motion is not None:
        return traffic.trajectory(ego.motion, end_s)
    if ego.poses is not None:
        if replay is None:
            raise ScenarioError("ego.poses: camera poses need a target that replays a label of the same recording")
        return replay.ego
    standing = Pose(vehicle_rotation(0.0), np.zeros(3))
    return Trajectory.standing(standing, np.array([-traffic.MARGIN_S, end_s + traffic.MARGIN_S]))


def _refuse_contact(actors: list[Actor], t_s: Array) -> None:
    """No two vehicle volumes may intersect at any frame."""
    for i, a in enumerate(actors):
        for b in actors[i + 1 :]:
            touch = meshes.volumes_intersect(a.model, a.trajectory.pose(t_s), b.model, b.trajectory.pose(t_s))
            if touch.any():
                k = int(np.argmax(touch))
                raise ScenarioError(f"vehicle: {a.name!r} and {b.name!r} touch at t = {t_s[k]:.2f} s (frame {k})")


def _passing(scenario: Scenario, actors: list[Actor], T_wc: Pose, t_s: Array) -> list[Actor]:
    """The cars that pass between camera and target."""
    cars = [Driver(a.name, a.model, a.trajectory) for a in actors]
    passing = passing_cars(scenario.realism.occluders, cars, scenario.target_index, T_wc, t_s, scenario.seed)
    return [Actor(p.name, p.model, p.trajectory) for p in passing]


def _props(scenario: Scenario, actors: list[Actor], ego: Trajectory, t_s: Array) -> tuple[Prop, ...]:
    """The street, along the ego car's path; nothing of it stands where something drives, nor in the line of sight to
    what was seen in a replayed recording."""
    ego_xy = ego.pose(t_s).t[:, :2]
    path = Path.through(ego_xy, _BEHIND_M, _AHEAD_M)
    length = _AHEAD_M if path is None else float(np.linalg.norm(np.diff(ego_xy, axis=0), axis=1).sum()) + _AHEAD_M
    street = build_roadside(
        stream(scenario.seed, 0, "world/roadside"),
        length_m=length,
        behind_m=_BEHIND_M,
        lanes=scenario.world.lanes,
        crossing_y=scenario.world.crossing_at_m,
    )
    free = [ego_xy, *(a.trajectory.pose(t_s).t[:, :2] for a in actors)]
    target = actors[scenario.target_index]
    if target.occlusion is not None:
        labelled = target.occlusion >= 0
        free.append(_lines(ego_xy[labelled], target.trajectory.pose(t_s[labelled]).t[:, :2]))
    return tuple(Prop(name, model, pose) for name, model, pose in follow(street, path, np.concatenate(free)))


def _lines(start: Float[Array, "n 2"], end: Float[Array, "n 2"]) -> Float[Array, "k 2"]:
    """Points on straight lines, at most `_LINE_STEP_M` apart."""
    count = int(np.ceil(np.linalg.norm(end - start, axis=1).max() / _LINE_STEP_M)) + 1
    share = np.linspace(0, 1, count)[:, None, None]
    return np.asarray((start + share * (end - start)).reshape(-1, 2))
