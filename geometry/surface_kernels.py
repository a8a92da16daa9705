"""Warp kernels, on the CPU, that look up the closest point of a triangle surface.

The nearest face is found in a tree of boxes in single precision, relative to the middle of the surface; what is said
about it - closest point, pseudo-normal, signed distance - is computed in double precision.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

ON_CORNER = wp.constant(wp.float64(1.0e-9))
"""A corner whose weight is less does not count: the closest point lies on the opposite edge."""


@wp.struct
class Surface:
    """A posed surface.

    Attributes:
        tree: ``wp.Mesh`` of the vertices relative to ``middle``.
        middle: Of the surface [m].
        vertices: World positions [m], shape [B].
        faces: Shape [F, 3].
        across: Face across the edge opposite of each corner, -1 at a boundary, shape [F, 3].
        first, around: Faces around each vertex, as offsets [B + 1] into a list [3 F].
    """

    tree: wp.uint64
    middle: wp.vec3d
    vertices: wp.array(dtype=wp.vec3d)
    faces: wp.array2d(dtype=int)
    across: wp.array2d(dtype=int)
    first: wp.array(dtype=int)
    around: wp.array(dtype=int)


@wp.func
def _area_vector(surface: Surface, face: int) -> wp.vec3d:
    a = surface.vertices[surface.faces[face, 0]]
    b = surface.vertices[surface.faces[face, 1]]
    c = surface.vertices[surface.faces[face, 2]]
    return wp.cross(b - a, c - a)


@wp.func
def _along(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d) -> wp.float64:
    """Share of the way from a to b at which the segment is closest to p."""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    ab = b - a
    return wp.clamp(wp.dot(p - a, ab) / wp.max(wp.dot(ab, ab), wp.float64(1.0e-300)), zero, one)


@wp.func
def _closest_weights(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d) -> wp.vec3d:
    """Barycentric weights of the point of a triangle that is closest to p."""
    zero, one = wp.float64(0.0), wp.float64(1.0)
    ab, ac, ap = b - a, c - a, p - a
    aa, bb, cross = wp.dot(ab, ab), wp.dot(ac, ac), wp.dot(ab, ac)
    pb, pc = wp.dot(ap, ab), wp.dot(ap, ac)
    determinant = aa * bb - cross * cross
    # A sliver's determinant is noise: treat it as its three edges.
    if determinant > wp.float64(1.0e-12) * aa * bb:
        v = (bb * pb - cross * pc) / determinant
        w = (aa * pc - cross * pb) / determinant
        if v >= zero and w >= zero and v + w <= one:
            return wp.vec3d(one - v - w, v, w)
    on_ab = _along(p, a, b)
    on_ac = _along(p, a, c)
    on_bc = _along(p, b, c)
    best = wp.vec3d(one - on_ab, on_ab, zero)
    least = wp.length_sq(p - a - on_ab * ab)
    other = wp.length_sq(p - a - on_ac * ac)
    if other < least:
        least = other
        best = wp.vec3d(one - on_ac, zero, on_ac)
    if wp.length_sq(p - b - on_bc * (c - b)) < least:
        best = wp.vec3d(zero, one - on_bc, on_bc)
    return best


@wp.func
def _pseudo_normal(surface: Surface, face: int, weights: wp.vec3d) -> wp.vec3d:
    """Unit pseudo-normal: the face's, the sum of an edge's two faces, a vertex's angle-weighted sum."""
    missing = int(0)
    opposite = int(0)
    corner = int(0)
    for k in range(3):
        if weights[k] <= ON_CORNER:
            missing += 1
            opposite = k
        else:
            corner = k
    normal = wp.normalize(_area_vector(surface, face))
    if missing == 1:
        other = surface.across[face, opposite]
        if other >= 0:
            normal += wp.normalize(_area_vector(surface, other))
    elif missing == 2:
        vertex = surface.faces[face, corner]
        here = surface.vertices[vertex]
        normal = wp.vec3d()
        for slot in range(surface.first[vertex], surface.first[vertex + 1]):
            near = surface.around[slot]
            at = int(0)
            for k in range(1, 3):
                if surface.faces[near, k] == vertex:
                    at = k
            u = surface.vertices[surface.faces[near, (at + 1) % 3]] - here
            v = surface.vertices[surface.faces[near, (at + 2) % 3]] - here
            area = wp.cross(u, v)
            normal += wp.atan2(wp.length(area), wp.dot(u, v)) * wp.normalize(area)
    return wp.normalize(normal)


@wp.kernel
def closest_points(
    surface: Surface,
    points: wp.array(dtype=wp.vec3d),
    reach: float,
    distance: wp.array(dtype=wp.float64),
    closest: wp.array(dtype=wp.vec3d),
    normal: wp.array(dtype=wp.vec3d),
    face: wp.array(dtype=int),
    weights: wp.array(dtype=wp.vec3d),
):
    """Closest points within ``reach`` [m]; where there is none, face -1 and the other outputs as they were."""
    i = wp.tid()
    p = points[i]
    offset = p - surface.middle
    found = wp.mesh_query_point_no_sign(
        surface.tree, wp.vec3(float(offset[0]), float(offset[1]), float(offset[2])), reach
    )
    face[i] = -1
    if found.result:
        f = found.face
        a = surface.vertices[surface.faces[f, 0]]
        b = surface.vertices[surface.faces[f, 1]]
        c = surface.vertices[surface.faces[f, 2]]
        w = _closest_weights(p, a, b, c)
        q = w[0] * a + w[1] * b + w[2] * c
        n = _pseudo_normal(surface, f, w)
        length = wp.length(p - q)
        if wp.dot(p - q, n) < wp.float64(0.0):
            length = -length
        face[i] = f
        weights[i] = w
        closest[i] = q
        normal[i] = n
        distance[i] = length


@wp.func
def _spread(
    points: wp.array(dtype=wp.vec3d),
    first: wp.array(dtype=int),
    neighbours: wp.array(dtype=int),
    reach: wp.float64,
    mark: int,
    waiting: int,
    state: wp.array(dtype=int),
    queue: wp.array(dtype=int),
):
    """Give ``mark`` to what the first ``waiting`` entries of the queue lead to."""
    while waiting > 0:
        waiting -= 1
        i = queue[waiting]
        for slot in range(first[i], first[i + 1]):
            j = neighbours[slot]
            if state[j] == 0:
                if wp.length_sq(points[j] - points[i]) < reach * reach:
                    state[j] = mark
                    queue[waiting] = j
                    waiting += 1


@wp.kernel
def find_sides(
    points: wp.array(dtype=wp.vec3d),
    first: wp.array(dtype=int),
    neighbours: wp.array(dtype=int),
    reach: wp.float64,
    distance: wp.array(dtype=wp.float64),
    state: wp.array(dtype=int),
    queue: wp.array(dtype=int),
):
    """Which vertices of a sheet are outside, of those without a face (state 0) within ``reach`` [m].

    About such a vertex there is a ball without surface, so that a neighbour in the ball is on the same side. State 1:
    it has a face. Out: 2, outside; 3, it hangs together with a vertex inside; 0, with none that is known. One thread.
    """
    # Queue holds every vertex once: what is marked is queued then and never again.
    count = int(0)
    for i in range(len(points)):
        if state[i] == 1 and distance[i] < wp.float64(0.0):
            queue[count] = i
            count += 1
    _spread(points, first, neighbours, reach, 3, count, state, queue)
    count = int(0)
    for i in range(len(points)):
        if state[i] == 1 and distance[i] >= wp.float64(0.0):
            queue[count] = i
            count += 1
    _spread(points, first, neighbours, reach, 2, count, state, queue)
