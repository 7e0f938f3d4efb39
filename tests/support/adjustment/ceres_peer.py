"""The same problem in Ceres, through the bundle adjustment of COLMAP and its rigs."""

from __future__ import annotations

import time

import numpy as np
import pyceres
import pycolmap

from tests.support.adjustment.problems import Peer, shared_rows


def rigid(R, t):
    """Target_from_source."""
    return pycolmap.Rigid3d(np.column_stack([R, t]))


NEWTON = {"initial_trust_region_radius": 1e16, "use_nonmonotonic_steps": True}
"""Next to no damping: of what was tried (its own settings, dogleg, Cholesky of all unknowns, steps
that may raise the cost or not) this converges fastest on an open traverse, whose long bending modes
damping holds back."""


def adjusted(problem, most_iterations=200, settings=NEWTON):
    """Ceres on the ties that several pairs saw; the time is that of its minimiser alone."""
    reconstruction = reconstruction_of(problem)
    config = config_of(reconstruction)
    config.set_constant_rig_from_world_pose(1)
    return solved(reconstruction, options_of(most_iterations, settings), config)


def options_of(most_iterations, settings):
    """One thread, sparse Schur complement, lenses and rigs as they are."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = False
    options.refine_sensor_from_rig = options.print_summary = False
    options.ceres.auto_select_solver_type = False
    solver = options.ceres.solver_options
    solver.linear_solver_type = pyceres.LinearSolverType.SPARSE_SCHUR
    solver.max_num_iterations, solver.num_threads = most_iterations, 1
    solver.function_tolerance, solver.gradient_tolerance = 1e-9, 1e-10
    for name, value in settings.items():
        setattr(solver, name, value)
    return options


def config_of(reconstruction):
    """All images."""
    config = pycolmap.BundleAdjustmentConfig()
    for image in reconstruction.images:
        config.add_image(image)
    return config


def solved(reconstruction, options, config):
    adjuster = pycolmap.create_default_bundle_adjuster(options, config, reconstruction)
    begin = time.process_time()
    summary = adjuster.solve().ceres_summary
    return Peer(2 * summary.final_cost, time.process_time() - begin, summary.BriefReport())


def reconstruction_of(problem):
    observations, state = problem.observations, problem.start
    reconstruction = pycolmap.Reconstruction()
    per_rig = rigs_of(observations, len(state.centres))
    for rig in sorted(set(per_rig.values())):
        add_rig(reconstruction, observations, rig, next(s for s, r in per_rig.items() if r == rig))
    rows = shared_rows(observations)
    of_pair = parted(rows, observations.pair[rows], len(observations.pair_stop))
    for stop, rig in per_rig.items():
        add_frame(reconstruction, problem, stop, rig, of_pair)
    slot = np.zeros(len(observations), dtype=int)
    for mine in of_pair:
        slot[mine] = np.arange(len(mine))
    elements = np.column_stack([2 * observations.pair + 1, slot]).tolist()
    for point, members in enumerate(parted(rows, observations.point[rows], observations.points)):
        if not len(members):
            continue
        track = pycolmap.Track()
        for image, number in (elements[row] for row in members.tolist()):
            track.add_element(image, number)
            track.add_element(image + 1, number)
        reconstruction.add_point3D(state.points[point], track)
    return reconstruction


def parted(rows, by, count):
    """Rows parted by a number that each has."""
    order = rows[np.argsort(by, kind="stable")]
    return np.split(order, np.cumsum(np.bincount(by, minlength=count))[:-1])


def rigs_of(observations, stops):
    """Number of the rig of every stop; stops with equal pairs share one."""
    known, of = {}, {}
    for stop in range(stops):
        pairs = np.flatnonzero(observations.pair_stop == stop)
        key = b"".join(
            a[pairs].tobytes()
            for a in (observations.rover_from_pair, observations.origin_in_rover,
                      observations.focal_px, observations.base_m)
        )  # fmt: skip
        of[stop] = known.setdefault(key, len(known) + 1)
    return of


def cameras_of(observations, stop):
    """(rotation, translation) cam_from_rover of left and right camera of every pair of a stop."""
    for pair in np.flatnonzero(observations.pair_stop == stop):
        R = observations.rover_from_pair[pair]
        for side in (-0.5, 0.5):
            centre = observations.origin_in_rover[pair] + side * observations.base_m[pair] * R[:, 0]
            yield int(pair), R.T, -R.T @ centre


def add_rig(reconstruction, observations, number, stop):
    rig = pycolmap.Rig(rig_id=number)
    first = None
    for k, (pair, R, t) in enumerate(cameras_of(observations, stop)):
        f, (cx, cy) = observations.focal_px[pair], observations.centre_px[pair]
        camera = pycolmap.Camera(
            camera_id=camera_id(number, k), model="PINHOLE", width=1024, height=1024,
            params=[f, f, cx, cy],
        )  # fmt: skip
        reconstruction.add_camera(camera)
        cam_from_rover = rigid(R, t)
        if first is None:
            first = cam_from_rover
            rig.add_ref_sensor(camera.sensor_id)
        else:
            rig.add_sensor(camera.sensor_id, cam_from_rover * first.inverse())
    reconstruction.add_rig(rig)


def camera_id(rig, k):
    return 1000 * rig + k + 1


def add_frame(reconstruction, problem, stop, rig, of_pair):
    observations, state = problem.observations, problem.start
    pairs = np.flatnonzero(observations.pair_stop == stop)
    _, R, t = next(cameras_of(observations, stop))
    rover_from_lsl = rigid(state.rotations[stop].T, -state.rotations[stop].T @ state.centres[stop])
    frame = pycolmap.Frame(
        frame_id=stop + 1, rig_id=rig, rig_from_world=rigid(R, t) * rover_from_lsl
    )
    images = []
    for k, pair in enumerate(pairs):
        x, y, p = observations.measured[of_pair[pair]].T
        for side, sign in ((0, 0.5), (1, -0.5)):
            image = pycolmap.Image(
                name=f"{pair}-{side}", keypoints=np.column_stack([x + sign * p, y]),
                camera_id=camera_id(rig, 2 * k + side), image_id=int(2 * pair + 1 + side),
            )  # fmt: skip
            image.frame_id = stop + 1
            frame.add_data_id(image.data_id)
            images.append(image)
    reconstruction.add_frame(frame)
    for image in images:
        reconstruction.add_image(image)
    reconstruction.register_frame(stop + 1)


def adjusted_with_lenses(problem, most_iterations=500):
    """A problem of `bal`, all nine unknowns of a camera free."""
    reconstruction = photographs_of(problem)
    options = options_of(most_iterations, {"function_tolerance": 1e-12})
    options.refine_focal_length = options.refine_extra_params = True
    return solved(reconstruction, options, config_of(reconstruction))


def photographs_of(problem):
    """Cameras that look along z, y down."""
    observations, state = problem.observations, problem.start
    turn = np.diag([1.0, -1.0, -1.0])
    reconstruction = pycolmap.Reconstruction()
    slots = np.zeros(len(observations), dtype=int)
    for k, (R, c, (f, k1, k2)) in enumerate(
        zip(state.rotations, state.centres, state.pointings, strict=True)
    ):
        camera = pycolmap.Camera(
            camera_id=k + 1, model="RADIAL", width=1, height=1, params=[f, 0.0, 0.0, k1, k2]
        )
        reconstruction.add_camera_with_trivial_rig(camera)
        mine = np.flatnonzero(observations.pair == k)
        slots[mine] = np.arange(len(mine))
        image = pycolmap.Image(
            name=str(k), keypoints=observations.measured[mine, :2] * [1.0, -1.0],
            camera_id=k + 1, image_id=k + 1,
        )  # fmt: skip
        to_camera = turn @ R.T
        pose = pycolmap.Rigid3d(np.column_stack([to_camera, -to_camera @ c]))
        reconstruction.add_image_with_trivial_frame(image, pose)
    order = np.argsort(observations.point, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(observations.point))[:-1])
    for point, rows in enumerate(parts):
        track = pycolmap.Track()
        for row in rows.tolist():
            track.add_element(int(observations.pair[row]) + 1, int(slots[row]))
        reconstruction.add_point3D(state.points[point], track)
    return reconstruction
