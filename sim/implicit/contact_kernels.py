"""Warp kernels of the contact with the moving body: query, velocity constraints, Coulomb friction, final projection.

A vertex near the body meets the plane through its closest body point, along the body's smooth normal. Where the step
would take it below that plane, the normal part of its new velocity is prescribed (Baraff & Witkin 1998, section 5) and
released as soon as the constraint would have to pull. Friction has two states. A *sticking* vertex moves with the body
until the impulse that holds it leaves the friction cone. A *sliding* vertex feels ``mu`` times its normal force of the
last step, written as a viscous force so that it cannot reverse the motion, for the speed that the last two steps
predict.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

# State of a vertex between steps.
APART, SLIDING, STICKING, STARTING = 0, 1, 2, 3


@wp.kernel
def place_body(
    start: wp.array(dtype=wp.vec3d),
    end: wp.array(dtype=wp.vec3d),
    share: wp.float64,
    points: wp.array(dtype=wp.vec3f),
):
    """Body vertices at ``share`` of the way through the frame."""
    i = wp.tid()
    points[i] = wp.vec3f((wp.float64(1.0) - share) * start[i] + share * end[i])


@wp.func
def on_face(
    values: wp.array(dtype=wp.vec3d),
    face: wp.vec3i,
    weights: wp.vec3d,
) -> wp.vec3d:
    """Barycentric interpolation over a face."""
    return weights[0] * values[face[0]] + weights[1] * values[face[1]] + weights[2] * values[face[2]]


@wp.kernel
def find_closest(
    meshes: wp.array(dtype=wp.uint64),
    face_offsets: wp.array(dtype=wp.int32),
    face_numbers: wp.array(dtype=wp.int32),
    group: wp.array(dtype=wp.int32),
    positions: wp.array(dtype=wp.vec3d),
    velocities: wp.array(dtype=wp.vec3d),
    ahead: wp.float64,
    radius: wp.float32,
    near: wp.float64,
    faces: wp.array(dtype=wp.vec3i),
    points: wp.array(dtype=wp.vec3f),
    normal_start: wp.array(dtype=wp.vec3d),
    normal_end: wp.array(dtype=wp.vec3d),
    share: wp.float64,
    hit_face: wp.array(dtype=wp.int32),
    hit_weights: wp.array(dtype=wp.vec3d),
):
    """Closest body point of each vertex where it will be after ``ahead`` [s]; -1 where none is within the radius.

    A part of the body is an open surface: points on its cut rim, where the offset lies across the normal, do not count.
    """
    i = wp.tid()
    g = group[i]
    hit_face[i] = -1
    if g < 0:
        return
    point = wp.vec3f(positions[i] + ahead * velocities[i])
    found = wp.mesh_query_point_no_sign(meshes[g], point, radius)
    if not found.result:
        return
    number = face_numbers[face_offsets[g] + found.face]
    u = wp.float64(found.u)
    v = wp.float64(found.v)
    weights = wp.vec3d(u, v, wp.float64(1.0) - u - v)
    face = faces[number]
    offset = wp.vec3d(
        point - found.u * points[face[0]] - found.v * points[face[1]] - (1.0 - found.u - found.v) * points[face[2]]
    )
    n = wp.normalize(
        (wp.float64(1.0) - share) * on_face(normal_start, face, weights) + share * on_face(normal_end, face, weights)
    )
    distance = wp.length(offset)
    if distance < near or wp.abs(wp.dot(n, offset)) > wp.float64(0.5) * distance:
        hit_face[i] = number
        hit_weights[i] = weights


@wp.kernel
def constrain(
    positions: wp.array(dtype=wp.vec3d),
    velocities: wp.array(dtype=wp.vec3d),
    masses: wp.array(dtype=wp.float64),
    pin: wp.array(dtype=wp.int32),
    pin_start: wp.array(dtype=wp.vec3d),
    pin_end: wp.array(dtype=wp.vec3d),
    hit_face: wp.array(dtype=wp.int32),
    hit_weights: wp.array(dtype=wp.vec3d),
    faces: wp.array(dtype=wp.vec3i),
    body_start: wp.array(dtype=wp.vec3d),
    body_end: wp.array(dtype=wp.vec3d),
    normal_start: wp.array(dtype=wp.vec3d),
    normal_end: wp.array(dtype=wp.vec3d),
    share_start: wp.float64,
    share_end: wp.float64,
    step: wp.float64,
    clearance: wp.array(dtype=wp.float64),
    friction: wp.float64,
    push_speed: wp.float64,
    stick_speed: wp.float64,
    diagonal: wp.array(dtype=wp.int32),
    state: wp.array(dtype=wp.int32),
    normal_force: wp.array(dtype=wp.float64),
    slip_speed: wp.array(dtype=wp.float64),
    starting_force: wp.array(dtype=wp.vec3d),
    body_velocity: wp.array(dtype=wp.vec3d),
    held: wp.array(dtype=wp.int32),
    normals: wp.array(dtype=wp.vec3d),
    solution: wp.array(dtype=wp.vec3d),
    matrix: wp.array(dtype=wp.mat33d),
    right_side: wp.array(dtype=wp.vec3d),
):
    """Prescribe the held directions of a step and add the friction of the sliding vertices to the system."""
    i = wp.tid()
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    x = positions[i]
    v = velocities[i]
    held[i] = 0
    solution[i] = wp.vec3d()
    thickness = clearance[i]
    k = pin[i]
    if k >= 0:
        target = (one - share_end) * pin_start[k] + share_end * pin_end[k]
        held[i] = 3
        solution[i] = (target - x) / step - v
        return
    if hit_face[i] < 0:
        state[i] = 0
        return

    face = faces[hit_face[i]]
    weights = hit_weights[i]
    begin = on_face(body_start, face, weights)
    end = on_face(body_end, face, weights)
    n = wp.normalize(
        (one - share_end) * on_face(normal_start, face, weights) + share_end * on_face(normal_end, face, weights)
    )
    point = (one - share_end) * begin + share_end * end
    motion = (share_end - share_start) / step * (end - begin)
    gap = wp.dot(n, x + step * v - point) - thickness
    if gap >= zero and state[i] == 0:
        return

    body_velocity[i] = motion
    normals[i] = n
    relative = v - motion
    approach = wp.dot(n, relative)
    slip = relative - approach * n
    speed = wp.length(slip)
    if state[i] == 0:
        # First touch: the impulse that stops the vertex alone stands for the force that is not known yet.
        normal_force[i] = masses[i] * wp.max(-gap, zero) / (step * step)
        slip_speed[i] = speed
        state[i] = 1
        if speed < stick_speed and friction > zero:
            state[i] = 2
    # Reach the plane at the end of the step, but leave a deep penetration slowly.
    wanted = wp.min((thickness - wp.dot(n, x + step * motion - point)) / step, push_speed)
    prescribed = (wanted - approach) * n
    if state[i] == 2:
        held[i] = 3
        solution[i] = prescribed - slip
        return
    held[i] = 1
    solution[i] = prescribed
    if state[i] == 3:
        right_side[i] += step * starting_force[i]
    else:
        predicted = wp.clamp(wp.float64(2.0) * speed - slip_speed[i], wp.float64(0.5) * speed, wp.float64(2.0) * speed)
        viscosity = friction * normal_force[i] / wp.max(predicted, wp.float64(1.0e-4))
        across = wp.identity(n=3, dtype=wp.float64) - wp.outer(n, n)
        matrix[diagonal[i]] += (step * viscosity) * across
        right_side[i] -= (step * viscosity) * slip
    slip_speed[i] = speed


@wp.kernel
def advance(
    step: wp.float64,
    friction: wp.float64,
    stick_speed: wp.float64,
    pin: wp.array(dtype=wp.int32),
    held: wp.array(dtype=wp.int32),
    normals: wp.array(dtype=wp.vec3d),
    solution: wp.array(dtype=wp.vec3d),
    impulse: wp.array(dtype=wp.vec3d),
    body_velocity: wp.array(dtype=wp.vec3d),
    positions: wp.array(dtype=wp.vec3d),
    velocities: wp.array(dtype=wp.vec3d),
    state: wp.array(dtype=wp.int32),
    normal_force: wp.array(dtype=wp.float64),
    slip_speed: wp.array(dtype=wp.float64),
    starting_force: wp.array(dtype=wp.vec3d),
):
    """Move the vertices and settle the contact state from the impulses that the constraints needed."""
    i = wp.tid()
    v = velocities[i] + solution[i]
    positions[i] = positions[i] + step * v
    velocities[i] = v
    if pin[i] >= 0 or held[i] == 0:
        return
    n = normals[i]
    force = impulse[i] / step
    pressing = wp.dot(n, force)
    relative = v - body_velocity[i]
    # The correction of the position is no motion: only the velocity of the body stays along the normal.
    velocities[i] = v - n * wp.dot(n, relative)
    if pressing <= wp.float64(0.0):
        state[i] = 0
        return
    normal_force[i] = pressing
    if held[i] == 3:
        holding = force - pressing * n
        needed = wp.length(holding)
        if needed > friction * pressing:
            state[i] = 3
            starting_force[i] = (friction * pressing / needed) * holding
    else:
        speed = wp.length(relative - n * wp.dot(n, relative))
        state[i] = 1
        # Slowing so fast that it would turn back in the next step: it has come to rest.
        if speed < stick_speed and wp.float64(2.0) * speed < slip_speed[i]:
            state[i] = 2


@wp.kernel
def project(
    hit_face: wp.array(dtype=wp.int32),
    hit_weights: wp.array(dtype=wp.vec3d),
    faces: wp.array(dtype=wp.vec3i),
    body: wp.array(dtype=wp.vec3d),
    body_normals: wp.array(dtype=wp.vec3d),
    pin: wp.array(dtype=wp.int32),
    clearance: wp.array(dtype=wp.float64),
    positions: wp.array(dtype=wp.vec3d),
    inside: wp.array(dtype=wp.int32),
    deepest: wp.array(dtype=wp.float64),
):
    """Move vertices that are below the surface to their clearance above it; count them and note the deepest."""
    i = wp.tid()
    if hit_face[i] < 0 or pin[i] >= 0:
        return
    face = faces[hit_face[i]]
    weights = hit_weights[i]
    n = wp.normalize(on_face(body_normals, face, weights))
    height = wp.dot(n, positions[i] - on_face(body, face, weights))
    if height < wp.float64(0.0):
        wp.atomic_add(inside, 0, 1)
        wp.atomic_max(deepest, 0, -height)
        positions[i] = positions[i] + (clearance[i] - height) * n
