"""USD: points, normals and extents as time samples; one time code is one frame.

The default prim ``/<animation>`` holds the meshes, and their materials (UsdPreviewSurface) under ``materials``.
Metres, y up. ``.usda`` is text, ``.usdc`` and ``.usd`` are binary.
"""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, UsdShade, Vt

from formats.animation import AnimatedMesh, Animation, plain_name
from formats.target import new_file

SUFFIXES = (".usd", ".usda", ".usdc")


def write_usd(path: str | os.PathLike, animation: Animation, force: bool = False) -> None:
    """Write a USD file, whole or not at all; errors as those of ``formats.target``."""
    with new_file(path, force) as temporary:
        stage = Usd.Stage.CreateInMemory(f"drapeline{Path(path).suffix}")
        _fill(stage, animation)
        if shutil.disk_usage(temporary.parent).free < 2 * sum(mesh.frames.nbytes for mesh in animation.meshes):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        # The library does not tell of every failed write, so what was written is read.
        try:
            whole = stage.GetRootLayer().Export(str(temporary)) and _reads_back(temporary, stage)
        except Tf.ErrorException:
            whole = False
        if not whole:
            raise OSError("only a part of it could be stored; is the disk full?")


def _fill(stage: Usd.Stage, animation: Animation) -> None:
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(animation.fps)
    stage.SetFramesPerSecond(animation.fps)
    stage.SetStartTimeCode(0.0)
    stage.SetEndTimeCode(animation.frames - 1.0)
    top = Sdf.Path("/" + plain_name(animation.name))
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, top).GetPrim())
    materials: dict[str, UsdShade.Material] = {}
    scope = top.AppendChild("materials")
    # A mesh of that name keeps it; the scope gives way.
    while any(mesh.name == scope.name for mesh in animation.meshes):
        scope = top.AppendChild(f"{scope.name}_")
    UsdGeom.Scope.Define(stage, scope)
    for mesh in animation.meshes:
        if mesh.material not in materials:
            materials[mesh.material] = _material(stage, scope.AppendChild(mesh.material), mesh)
        own = _mesh(stage, top.AppendChild(mesh.name), mesh)
        UsdShade.MaterialBindingAPI.Apply(own.GetPrim()).Bind(materials[mesh.material])


def _mesh(stage: Usd.Stage, path: Sdf.Path, mesh: AnimatedMesh) -> UsdGeom.Mesh:
    own = UsdGeom.Mesh.Define(stage, path)
    own.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, dtype=np.int32)))
    own.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.faces.reshape(-1)))
    own.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    own.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    own.CreateDoubleSidedAttr(mesh.name != "body")
    own.CreateDisplayColorAttr(Vt.Vec3fArray([mesh.linear_colour]))
    if mesh.uv is not None:
        primvars = UsdGeom.PrimvarsAPI(own)
        st = primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
        st.Set(Vt.Vec2fArray.FromNumpy(mesh.uv))
    points, normals, extent = own.CreatePointsAttr(), own.CreateNormalsAttr(), own.CreateExtentAttr()
    own.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    for frame, (vertices, directions) in enumerate(zip(mesh.frames, mesh.normals())):
        points.Set(Vt.Vec3fArray.FromNumpy(vertices), frame)
        normals.Set(Vt.Vec3fArray.FromNumpy(directions), frame)
        extent.Set(Vt.Vec3fArray.FromNumpy(np.stack([vertices.min(axis=0), vertices.max(axis=0)])), frame)
    return own


def _material(stage: Usd.Stage, path: Sdf.Path, mesh: AnimatedMesh) -> UsdShade.Material:
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path.AppendChild("surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(mesh.linear_colour)
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.9)
    shader.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(0.0)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return material


def _reads_back(path: Path, stage: Usd.Stage) -> bool:
    """Whether all samples of all meshes came to the disk."""
    again = Usd.Stage.Open(Sdf.Layer.OpenAsAnonymous(str(path)))
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh):
            for name in ("points", "normals"):
                own, found = prim.GetAttribute(name), again.GetPrimAtPath(prim.GetPath()).GetAttribute(name)
                if not found or any(found.Get(time) != own.Get(time) for time in own.GetTimeSamples()):
                    return False
    return True
