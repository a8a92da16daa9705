"""Strain limiting: principal stretches of every triangle brought back between two bounds (ARCSim's option).

The bounds act on the singular values of the deformation gradient (Wang, O'Brien & Ramamoorthi 2010; ARCSim's materials
name 0.95 and 1.05). Triangles are visited in order and corrected one after the other without moving their
centre of mass, in sweeps, until the worst stretch is within a tenth of the bounds' distance or the sweeps are used up.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def limit_strain(
    faces: wp.array(dtype=wp.vec3i),
    along_u: wp.array(dtype=wp.vec3d),
    along_v: wp.array(dtype=wp.vec3d),
    inverse_masses: wp.array(dtype=wp.float64),
    held: wp.array(dtype=wp.int32),
    low: wp.float64,
    high: wp.float64,
    max_sweeps: wp.int32,
    positions: wp.array(dtype=wp.vec3d),
    sweeps: wp.array(dtype=wp.int32),
):
    """All sweeps in one thread: Gauss-Seidel needs the order, and the solver's device is a CPU."""
    one = wp.float64(1.0)
    zero = wp.float64(0.0)
    slack = wp.float64(0.1) * (high - low)
    half = wp.float64(0.5)
    count = wp.int32(0)
    worst = slack + one
    while count < max_sweeps and worst > slack:
        worst = zero
        count += wp.int32(1)
        for f in range(faces.shape[0]):
            face = faces[f]
            bu = along_u[f]
            bv = along_v[f]
            wu = bu[0] * positions[face[0]] + bu[1] * positions[face[1]] + bu[2] * positions[face[2]]
            wv = bv[0] * positions[face[0]] + bv[1] * positions[face[1]] + bv[2] * positions[face[2]]
            # Principal stretches from the 2 x 2 metric [[a, b], [b, c]].
            a = wp.dot(wu, wu)
            b = wp.dot(wu, wv)
            c = wp.dot(wv, wv)
            spread = wp.sqrt(half * half * (a - c) * (a - c) + b * b)
            s1 = wp.sqrt(half * (a + c) + spread)
            s2 = wp.sqrt(wp.max(half * (a + c) - spread, wp.float64(1.0e-12)))
            excess = wp.max(s1 - high, low - s2)
            if excess > zero:
                worst = wp.max(worst, excess)
                angle = half * wp.atan2(wp.float64(2.0) * b, a - c)
                co = wp.cos(angle)
                si = wp.sin(angle)
                f1 = wp.clamp(s1, low, high) / s1
                f2 = wp.clamp(s2, low, high) / s2
                # New columns: F V diag(f1, f2) V^T.
                m00 = f1 * co * co + f2 * si * si
                m01 = (f1 - f2) * co * si
                m11 = f1 * si * si + f2 * co * co
                nu = m00 * wu + m01 * wv
                nv = m01 * wu + m11 * wv
                change_u = nu - wu
                change_v = nv - wv
                # Rest edges in material coordinates (the inverse of the gradients) give the corners' displacements
                # against the first corner.
                scale = one / (bu[1] * bv[2] - bu[2] * bv[1])
                e1u = scale * bv[2]
                e1v = -scale * bu[2]
                e2u = -scale * bv[1]
                e2v = scale * bu[1]
                d1 = e1u * change_u + e1v * change_v
                d2 = e2u * change_u + e2v * change_v
                q0 = inverse_masses[face[0]]
                q1 = inverse_masses[face[1]]
                q2 = inverse_masses[face[2]]
                if held[face[0]] == 3:
                    q0 = zero
                if held[face[1]] == 3:
                    q1 = zero
                if held[face[2]] == 3:
                    q2 = zero
                # Centre of mass at rest: sum m_i d_i = 0; an immovable vertex (q = 0) keeps its place instead.
                if q0 > zero and q1 > zero and q2 > zero:
                    m0 = one / q0
                    m1 = one / q1
                    m2 = one / q2
                    d0 = -(m1 * d1 + m2 * d2) / (m0 + m1 + m2)
                    positions[face[0]] = positions[face[0]] + d0
                    positions[face[1]] = positions[face[1]] + d0 + d1
                    positions[face[2]] = positions[face[2]] + d0 + d2
                else:
                    shift = wp.vec3d()
                    fixed = zero
                    if q0 == zero:
                        fixed += one
                    if q1 == zero:
                        shift -= d1
                        fixed += one
                    if q2 == zero:
                        shift -= d2
                        fixed += one
                    shift = shift / fixed
                    if q0 > zero:
                        positions[face[0]] = positions[face[0]] + shift
                    if q1 > zero:
                        positions[face[1]] = positions[face[1]] + shift + d1
                    if q2 > zero:
                        positions[face[2]] = positions[face[2]] + shift + d2
    sweeps[0] = count
