"""Sparse block matrix of a garment and the filtered conjugate gradients that solve a step.

The sparsity pattern follows from the connectivity alone (each vertex couples with its neighbours and with the vertices
across its hinges), so block positions are computed once and every step only adds numbers. The solver is the modified
conjugate gradient method of Baraff & Witkin 1998, section 5.2, in the form of Ascher & Boxerman 2003: constrained
directions hold their prescribed change of velocity and are filtered out of every search direction.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import warp as wp

from geometry.topology import MeshTopology

wp.set_module_options({"enable_backward": False})

# What is held at a vertex: nothing, the direction of its contact normal, everything.
FREE, HELD_NORMAL, HELD = 0, 1, 3


@wp.func
def filtered(value: wp.vec3d, held: wp.int32, normal: wp.vec3d) -> wp.vec3d:
    """The part of ``value`` that the constraints of its vertex leave free."""
    if held == 3:
        return wp.vec3d()
    if held == 1:
        return value - normal * wp.dot(normal, value)
    return value


@wp.func
def row_product(
    row: wp.int32,
    rows: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    matrix: wp.array(dtype=wp.mat33d),
    value: wp.array(dtype=wp.vec3d),
) -> wp.vec3d:
    """Block row of the matrix times the vector."""
    total = wp.vec3d()
    for k in range(rows[row], rows[row + 1]):
        total += matrix[k] * value[columns[k]]
    return total


@wp.kernel
def invert_diagonal(
    diagonal: wp.array(dtype=wp.int32),
    matrix: wp.array(dtype=wp.mat33d),
    held: wp.array(dtype=wp.int32),
    normals: wp.array(dtype=wp.vec3d),
    inverse: wp.array(dtype=wp.mat33d),
):
    """Block-Jacobi preconditioner of the filtered system."""
    i = wp.tid()
    block = matrix[diagonal[i]]
    if held[i] == 1:
        n = normals[i]
        across = wp.identity(n=3, dtype=wp.float64) - wp.outer(n, n)
        block = across * block * across + wp.trace(block) * wp.outer(n, n)
    inverse[i] = wp.inverse(block)


@wp.kernel
def start_search(
    rows: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    matrix: wp.array(dtype=wp.mat33d),
    right_side: wp.array(dtype=wp.vec3d),
    held: wp.array(dtype=wp.int32),
    normals: wp.array(dtype=wp.vec3d),
    inverse: wp.array(dtype=wp.mat33d),
    solution: wp.array(dtype=wp.vec3d),
    residual: wp.array(dtype=wp.vec3d),
    search: wp.array(dtype=wp.vec3d),
    scalars: wp.array(dtype=wp.float64),
):
    """Residual and first search direction; ``solution`` holds the prescribed values and zero elsewhere."""
    i = wp.tid()
    r = filtered(right_side[i] - row_product(i, rows, columns, matrix, solution), held[i], normals[i])
    s = filtered(inverse[i] * r, held[i], normals[i])
    residual[i] = r
    search[i] = s
    wp.atomic_add(scalars, 1, wp.dot(r, s))


@wp.kernel
def multiply_search(
    rows: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    matrix: wp.array(dtype=wp.mat33d),
    held: wp.array(dtype=wp.int32),
    normals: wp.array(dtype=wp.vec3d),
    search: wp.array(dtype=wp.vec3d),
    product: wp.array(dtype=wp.vec3d),
    scalars: wp.array(dtype=wp.float64),
):
    """Filtered matrix times search direction, and the curvature along it into ``scalars[0]``."""
    i = wp.tid()
    q = filtered(row_product(i, rows, columns, matrix, search), held[i], normals[i])
    product[i] = q
    wp.atomic_add(scalars, 0, wp.dot(search[i], q))


@wp.kernel
def advance_solution(
    held: wp.array(dtype=wp.int32),
    normals: wp.array(dtype=wp.vec3d),
    inverse: wp.array(dtype=wp.mat33d),
    search: wp.array(dtype=wp.vec3d),
    product: wp.array(dtype=wp.vec3d),
    solution: wp.array(dtype=wp.vec3d),
    residual: wp.array(dtype=wp.vec3d),
    preconditioned: wp.array(dtype=wp.vec3d),
    scalars: wp.array(dtype=wp.float64),
):
    """Step along the search direction; the new residual's norm goes into ``scalars[2]``."""
    i = wp.tid()
    alpha = scalars[1] / scalars[0]
    solution[i] += alpha * search[i]
    r = residual[i] - alpha * product[i]
    s = filtered(inverse[i] * r, held[i], normals[i])
    residual[i] = r
    preconditioned[i] = s
    wp.atomic_add(scalars, 2, wp.dot(r, s))


@wp.kernel
def turn_search(
    preconditioned: wp.array(dtype=wp.vec3d),
    search: wp.array(dtype=wp.vec3d),
    scalars: wp.array(dtype=wp.float64),
):
    """Next conjugate search direction."""
    i = wp.tid()
    search[i] = preconditioned[i] + (scalars[2] / scalars[1]) * search[i]


@wp.kernel
def constraint_impulse(
    rows: wp.array(dtype=wp.int32),
    columns: wp.array(dtype=wp.int32),
    matrix: wp.array(dtype=wp.mat33d),
    right_side: wp.array(dtype=wp.vec3d),
    solution: wp.array(dtype=wp.vec3d),
    held: wp.array(dtype=wp.int32),
    impulse: wp.array(dtype=wp.vec3d),
):
    """Impulse ``A dv - b`` [N s] with which the constraints act on the vertices that they hold."""
    i = wp.tid()
    if held[i] == 0:
        impulse[i] = wp.vec3d()
    else:
        impulse[i] = row_product(i, rows, columns, matrix, solution) - right_side[i]


class BlockSystem:
    """Symmetric system of 3 x 3 blocks over the vertices of a garment, with constraints and its solver.

    Attributes:
        matrix, right_side: A [kg] and b [N s] of the step, filled by the force kernels.
        held, normals: Constraint of each vertex (``FREE``, ``HELD_NORMAL``, ``HELD``) and the held unit direction.
        solution: Before :meth:`solve` the prescribed change of velocity [m/s] of held directions and zero elsewhere;
            afterwards the change of velocity of every vertex.
        impulse: Constraint impulses [N s] after :meth:`solve`.
    """

    def __init__(self, topology: MeshTopology):
        count = topology.vertex_count
        # Two tips of a hinge are the only pairs that share no edge.
        pairs = np.concatenate([topology.edges, np.sort(topology.hinges[:, 2:], axis=1)]).astype(np.int64)
        keys = np.unique(
            np.concatenate([pairs @ [count, 1], pairs @ [1, count], np.arange(count, dtype=np.int64) * (count + 1)])
        )
        self.count = count
        self._keys = keys
        self._columns = (keys % count).astype(np.int32)
        self._rows = np.searchsorted(keys, np.arange(count + 1, dtype=np.int64) * count).astype(np.int32)
        diagonal = np.searchsorted(keys, np.arange(count, dtype=np.int64) * (count + 1)).astype(np.int32)

        def vectors() -> wp.array:
            return wp.zeros(count, dtype=wp.vec3d, device="cpu")

        self.rows = wp.array(self._rows, dtype=wp.int32, device="cpu")
        self.columns = wp.array(self._columns, dtype=wp.int32, device="cpu")
        self.diagonal = wp.array(diagonal, dtype=wp.int32, device="cpu")
        self.matrix = wp.zeros(len(keys), dtype=wp.mat33d, device="cpu")
        self.inverse = wp.zeros(count, dtype=wp.mat33d, device="cpu")
        self.held = wp.zeros(count, dtype=wp.int32, device="cpu")
        self.normals, self.solution, self.impulse, self.right_side = vectors(), vectors(), vectors(), vectors()
        residual, search, product, preconditioned = vectors(), vectors(), vectors(), vectors()
        scalars = wp.zeros(3, dtype=wp.float64, device="cpu")
        # Shares memory with the array: kernels on the CPU are synchronous, so Python may read it between launches.
        self._scalars = scalars.numpy()

        pattern = [self.rows, self.columns, self.matrix]
        constraints = [self.held, self.normals]
        # Recorded launches cost a fifth of a call of wp.launch, and a step makes hundreds of them.
        self._invert = self._record(invert_diagonal, [self.diagonal, self.matrix, *constraints, self.inverse])
        self._start = self._record(
            start_search,
            [*pattern, self.right_side, *constraints, self.inverse, self.solution, residual, search, scalars],
        )
        self._multiply = self._record(multiply_search, [*pattern, *constraints, search, product, scalars])
        self._advance = self._record(
            advance_solution,
            [*constraints, self.inverse, search, product, self.solution, residual, preconditioned, scalars],
        )
        self._turn = self._record(turn_search, [preconditioned, search, scalars])
        self._impulse = self._record(
            constraint_impulse, [*pattern, self.right_side, self.solution, self.held, self.impulse]
        )

    def _record(self, kernel: wp.Kernel, inputs: list) -> wp.Launch:
        return wp.launch(kernel, dim=self.count, inputs=inputs, device="cpu", record_cmd=True)

    def block_indices(self, elements: np.ndarray) -> np.ndarray:
        """Where the blocks of elements lie: ``elements [N, K]`` -> positions in ``matrix``, shape [N, K * K]."""
        elements = elements.astype(np.int64)
        keys = elements[:, :, None] * self.count + elements[:, None, :]
        return np.searchsorted(self._keys, keys.reshape(len(elements), -1)).astype(np.int32)

    def to_scipy(self) -> sp.bsr_matrix:
        """The matrix as it stands, shape [3 V, 3 V]."""
        blocks = self.matrix.numpy().copy()
        return sp.bsr_matrix((blocks, self._columns, self._rows), shape=(3 * self.count, 3 * self.count))

    def solve(self, tolerance: float, max_iterations: int) -> int:
        """Solve for ``solution`` under the constraints; returns the number of iterations.

        Args:
            tolerance: Wanted ratio of the preconditioned residual's norm to that of the right side.
            max_iterations: Stop here even if the tolerance is not reached.
        """
        scalars = self._scalars
        scalars[:] = 0.0
        self._invert.launch()
        self._start.launch()
        goal = tolerance * tolerance * scalars[1]
        iteration = 0
        while iteration < max_iterations and scalars[1] > goal and scalars[1] > 0.0:
            scalars[0] = scalars[2] = 0.0
            self._multiply.launch()
            if not scalars[0] > 0.0:
                # Only a matrix that holds NaN gets here: leave it to the caller's check of the velocities.
                break
            self._advance.launch()
            self._turn.launch()
            scalars[1] = scalars[2]
            iteration += 1
        self._impulse.launch()
        return iteration
