"""Where a body passes through itself or closes on itself."""

from __future__ import annotations

import warp as wp

from sim.kernels.winding import winding_number

wp.set_module_options({"enable_backward": False})

# Rays across a gap start this far above their own face [m], beyond float32 rounding.
_CLEAR = wp.constant(1.0e-5)


@wp.kernel
def wind_faces(
    mesh: wp.uint64, points: wp.array(dtype=wp.vec3), indices: wp.array(dtype=int), winding: wp.array(dtype=int)
):
    """Winding number just outside of the centre of each face.

    The ray follows the coordinate axis nearest to the face's normal, on its outer side, and leaves the face itself out:
    no offset has to be chosen.
    """
    i = wp.tid()
    a = points[indices[3 * i]]
    b = points[indices[3 * i + 1]]
    c = points[indices[3 * i + 2]]
    normal = wp.cross(b - a, c - a)
    axis = wp.int32(0)
    for k in range(1, 3):
        if wp.abs(normal[k]) > wp.abs(normal[axis]):
            axis = k
    direction = wp.where(normal[axis] > 0.0, 1.0, -1.0)
    winding[i] = winding_number(mesh, points, indices, (a + b + c) / 3.0, axis, direction, i)


@wp.kernel
def find_gaps(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    winding: wp.array(dtype=int),
    gap: float,
    closing: wp.array(dtype=wp.bool),
):
    """Mark faces that face each other across less than ``gap`` [m], along the normal of one of them."""
    i = wp.tid()
    if winding[i] != 0:
        return
    a = points[indices[3 * i]]
    b = points[indices[3 * i + 1]]
    c = points[indices[3 * i + 2]]
    normal = wp.normalize(wp.cross(b - a, c - a))
    ray = wp.mesh_query_ray(mesh, (a + b + c) / 3.0 + normal * _CLEAR, normal, gap - _CLEAR)
    if ray.result and wp.dot(ray.normal, normal) < 0.0:
        closing[i] = True
        closing[ray.face] = True
