"""Warp kernels of the implicit solver's forces, each adding one energy to the linear system of a step.

The system of Baraff & Witkin 1998 (equation 6) is ``A dv = b`` with ``A = M + h D + h^2 K`` and
``b = h (f + f_damping) - h^2 K v``; K is the stiffness matrix (minus the force Jacobian) and D the damping matrix.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def add_membrane(
    positions: wp.array(dtype=wp.vec3d),
    velocities: wp.array(dtype=wp.vec3d),
    faces: wp.array(dtype=wp.vec3i),
    along_u: wp.array(dtype=wp.vec3d),
    along_v: wp.array(dtype=wp.vec3d),
    areas: wp.array(dtype=wp.float64),
    blocks: wp.array2d(dtype=wp.int32),
    stretch: wp.float64,
    shear: wp.float64,
    compression: wp.float64,
    damping: wp.float64,
    step: wp.float64,
    matrix: wp.array(dtype=wp.mat33d),
    right_side: wp.array(dtype=wp.vec3d),
):
    """Stretch and shear of one triangle (Baraff & Witkin 1998, section 4).

    Positive semi-definite by construction: the part of the stretch Hessian across the thread is dropped under
    compression, and the shear Hessian keeps its Gauss-Newton part only.
    """
    f = wp.tid()
    face = faces[f]
    bu = along_u[f]
    bv = along_v[f]
    one = wp.float64(1.0)
    wu = wp.vec3d()
    wv = wp.vec3d()
    du = wp.vec3d()
    dv = wp.vec3d()
    for i in range(3):
        x = positions[face[i]]
        v = velocities[face[i]]
        wu += bu[i] * x
        wv += bv[i] * x
        du += bu[i] * v
        dv += bv[i] * v

    area = areas[f]
    square = step * step
    lu = wp.max(wp.length(wu), wp.float64(1.0e-9))
    lv = wp.max(wp.length(wv), wp.float64(1.0e-9))
    nu = wu / lu
    nv = wv / lv
    ku = area * stretch
    kv = area * stretch
    across_u = one - one / lu
    across_v = one - one / lv
    if lu < one:
        ku *= compression
        across_u = wp.float64(0.0)
    if lv < one:
        kv *= compression
        across_v = wp.float64(0.0)
    ks = area * shear
    angle = wp.dot(wu, wv)

    # Hessian over (w_u, w_v); the along-thread part also carries the damping: h^2 K + h D.
    along = square + step * damping
    identity = wp.identity(n=3, dtype=wp.float64)
    uu = wp.outer(nu, nu)
    vv = wp.outer(nv, nv)
    m_uu = (ku * along) * uu + (ku * square * across_u) * (identity - uu) + (ks * along) * wp.outer(wv, wv)
    m_vv = (kv * along) * vv + (kv * square * across_v) * (identity - vv) + (ks * along) * wp.outer(wu, wu)
    m_uv = (ks * along) * wp.outer(wv, wu)

    # h f + h f_damping - h^2 K v, with the minus sign left to the end.
    rate = wp.dot(du, wv) + wp.dot(wu, dv)
    shear_term = ks * (step * angle + along * rate)
    ru = (ku * (step * (lu - one) + along * wp.dot(nu, du))) * nu + shear_term * wv
    rv = (kv * (step * (lv - one) + along * wp.dot(nv, dv))) * nv + shear_term * wu
    ru += (ku * square * across_u) * (du - nu * wp.dot(nu, du))
    rv += (kv * square * across_v) * (dv - nv * wp.dot(nv, dv))

    for i in range(3):
        wp.atomic_add(right_side, face[i], -(bu[i] * ru + bv[i] * rv))
        first = bu[i] * m_uu + bv[i] * wp.transpose(m_uv)
        second = bu[i] * m_uv + bv[i] * m_vv
        for j in range(3):
            wp.atomic_add(matrix, blocks[f, 3 * i + j], bu[j] * first + bv[j] * second)


@wp.kernel
def add_bending(
    positions: wp.array(dtype=wp.vec3d),
    velocities: wp.array(dtype=wp.vec3d),
    hinges: wp.array(dtype=wp.vec4i),
    weights: wp.array(dtype=wp.vec4d),
    stiffness: wp.float64,
    damping: wp.float64,
    step: wp.float64,
    right_side: wp.array(dtype=wp.vec3d),
):
    """Isometric bending force of one hinge (Bergou et al. 2006). Its matrix is constant and assembled once."""
    h = wp.tid()
    hinge = hinges[h]
    c = weights[h]
    bent = wp.vec3d()
    rate = wp.vec3d()
    for i in range(4):
        bent += c[i] * positions[hinge[i]]
        rate += c[i] * velocities[hinge[i]]
    impulse = stiffness * (step * bent + (step * step + step * damping) * rate)
    for i in range(4):
        wp.atomic_add(right_side, hinge[i], -c[i] * impulse)


@wp.kernel
def add_body_forces(
    positions: wp.array(dtype=wp.vec3d),
    velocities: wp.array(dtype=wp.vec3d),
    masses: wp.array(dtype=wp.float64),
    areas: wp.array(dtype=wp.float64),
    first_corner: wp.array(dtype=wp.int32),
    corners: wp.array(dtype=wp.vec2i),
    diagonal: wp.array(dtype=wp.int32),
    gravity: wp.vec3d,
    wind: wp.vec3d,
    normal_drag: wp.float64,
    tangential_drag: wp.float64,
    extra_damping: wp.float64,
    step: wp.float64,
    matrix: wp.array(dtype=wp.mat33d),
    right_side: wp.array(dtype=wp.vec3d),
):
    """Weight, drag of the air and extra damping: sets the right side, which the other kernels then add to.

    The air pulls with ``-A [c_n (v_r . n) n + c_t (v_r - (v_r . n) n)]`` on a vertex of area A with the area-weighted
    normal n, where v_r is its velocity against the wind. Implicit in the velocity; n is that of the step's start.
    ``corners`` holds the other two vertices of each face around a vertex, in the face's order.
    """
    i = wp.tid()
    x = positions[i]
    n = wp.vec3d()
    for c in range(first_corner[i], first_corner[i + 1]):
        pair = corners[c]
        n += wp.cross(positions[pair[0]] - x, positions[pair[1]] - x)
    n = wp.normalize(n)
    against = velocities[i] - wind
    along = wp.dot(n, against) * n
    drag = areas[i] * (normal_drag * along + tangential_drag * (against - along))
    loss = extra_damping * masses[i]
    right_side[i] = step * (masses[i] * gravity - drag - loss * velocities[i])
    across = areas[i] * tangential_drag + loss
    block = across * wp.identity(n=3, dtype=wp.float64)
    block += (areas[i] * (normal_drag - tangential_drag)) * wp.outer(n, n)
    matrix[diagonal[i]] += step * block
