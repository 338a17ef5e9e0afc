"""Writes the mesh files of this folder: two boxes that share a face, 40 x 30 x 20 mm, "liver" and "fat".

    python -m venv venv && venv/bin/pip install gmsh==4.15.2 meshio==5.3.5 vtk==9.7.2
    venv/bin/python write.py

Each file is written by the program that its comment names; `reference.json` has the corners and the region of each cell
as gmsh holds them in memory.
"""

import json
import sys
from pathlib import Path

import gmsh
import meshio
import numpy as np
import vtk

OUT = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
LIVER, FAT = 7, 9


def model():
    """Two boxes, fragmented, with groups for both volumes and for the outer faces."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    left = gmsh.model.occ.addBox(0, 0, 0, 25, 30, 20)
    right = gmsh.model.occ.addBox(25, 0, 0, 15, 30, 20)
    gmsh.model.occ.fragment([(3, left)], [(3, right)])
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [left], LIVER, "liver")
    gmsh.model.addPhysicalGroup(3, [right], FAT, "fat")
    faces = [tag for _, tag in gmsh.model.getEntities(2)]
    gmsh.model.addPhysicalGroup(2, faces, 3, "faces")
    gmsh.option.setNumber("Mesh.MeshSizeMin", 13)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 13)
    gmsh.model.mesh.generate(3)


def reference():
    """Corners and group of each tetrahedron, from gmsh's memory."""
    tags, xyz, _ = gmsh.model.mesh.getNodes()
    at = dict(zip(tags, xyz.reshape(-1, 3)))
    cells, regions = [], []
    for group in (LIVER, FAT):
        for entity in gmsh.model.getEntitiesForPhysicalGroup(3, group):
            _, nodes = gmsh.model.mesh.getElementsByType(4, entity)
            cells += [[at[n].tolist() for n in c] for c in nodes.reshape(-1, 4)]
            regions += [group] * (len(nodes) // 4)
    return {"nodes": len(tags), "cells": cells, "regions": regions}


def by_gmsh():
    """`.msh` 2.2 and 4.1 as text and bytes, `.mesh`, `.inp`; 4.1 of second order."""
    for version in (2.2, 4.1):
        for binary in (0, 1):
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
            gmsh.option.setNumber("Mesh.Binary", binary)
            name = f"gmsh{round(10 * version)}-{'binary' if binary else 'ascii'}.msh"
            gmsh.write(str(OUT / name))
    gmsh.option.setNumber("Mesh.Binary", 0)
    # References of medit are physical groups; sets of abaqus are these and the volumes.
    gmsh.option.setNumber("Mesh.SaveElementTagType", 2)
    gmsh.write(str(OUT / "gmsh.mesh"))
    gmsh.option.setNumber("Mesh.SaveGroupsOfElements", 1)
    gmsh.write(str(OUT / "gmsh.inp"))
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)


def grid():
    """What VTK and meshio write: nodes and tetrahedra as gmsh's 4.1 file has them, with the array `gmsh:physical`."""
    mesh = meshio.read(OUT / "gmsh41-ascii.msh")
    blocks = [(b.data, r) for b, r in zip(mesh.cells, mesh.cell_data["gmsh:physical"]) if b.type == "tetra"]
    cells = np.vstack([b for b, _ in blocks])
    regions = np.concatenate([r for _, r in blocks]).astype(np.int32)
    return meshio.Mesh(mesh.points, [("tetra", cells)], cell_data={"gmsh:physical": [regions]})


def by_vtk(mesh):
    """Legacy files of version 5.1, `.vtu` in five ways."""
    out = vtk.vtkUnstructuredGrid()
    points = vtk.vtkPoints()
    points.SetDataTypeToDouble()
    for p in mesh.points:
        points.InsertNextPoint(*p)
    out.SetPoints(points)
    for cell in mesh.cells[0].data:
        out.InsertNextCell(vtk.VTK_TETRA, 4, [int(n) for n in cell])
    stress = vtk.vtkDoubleArray()
    stress.SetName("stress")
    region = vtk.vtkIntArray()
    region.SetName("MaterialIds")
    for k, r in enumerate(mesh.cell_data["gmsh:physical"][0]):
        stress.InsertNextValue(0.5 * k)
        region.InsertNextValue(int(r))
    out.GetCellData().AddArray(stress)
    out.GetCellData().AddArray(region)
    for name, binary in (("vtk51-ascii.vtk", False), ("vtk51-binary.vtk", True)):
        writer = vtk.vtkUnstructuredGridWriter()
        writer.SetFileName(str(OUT / name))
        writer.SetInputData(out)
        writer.SetFileTypeToBinary() if binary else writer.SetFileTypeToASCII()
        writer.Write()
    for name, mode, packed, base64, wide, big in (
        ("ascii", "Ascii", False, False, False, False),
        ("base64", "Binary", False, False, False, True),
        ("base64-zlib", "Binary", True, False, True, False),
        ("raw", "Appended", False, False, True, False),
        ("raw-zlib", "Appended", True, False, False, False),
        ("appended-base64-zlib", "Appended", True, True, False, False),
    ):
        writer = vtk.vtkXMLUnstructuredGridWriter()
        writer.SetFileName(str(OUT / f"vtk-{name}.vtu"))
        writer.SetInputData(out)
        getattr(writer, f"SetDataModeTo{mode}")()
        writer.SetCompressorTypeToZLib() if packed else writer.SetCompressorTypeToNone()
        writer.SetEncodeAppendedData(base64)
        writer.SetHeaderTypeToUInt64() if wide else writer.SetHeaderTypeToUInt32()
        writer.SetByteOrderToBigEndian() if big else writer.SetByteOrderToLittleEndian()
        # Several blocks even of so small a mesh.
        writer.SetBlockSize(1024)
        writer.Write()


def by_meshio(mesh):
    """Legacy files of version 4.2, `.vtu`, tetgen with an attribute."""
    mesh.write(OUT / "meshio42-ascii.vtk", file_format="vtk42", binary=False)
    mesh.write(OUT / "meshio42-binary.vtk", file_format="vtk42", binary=True)
    mesh.write(OUT / "meshio.vtu")
    named = meshio.Mesh(mesh.points, mesh.cells, cell_data={"tetgen:ref": mesh.cell_data["gmsh:physical"]})
    named.write(OUT / "meshio.node")


def second_order():
    """The same cells with ten nodes each, edges straight."""
    gmsh.model.mesh.setOrder(2)
    gmsh.option.setNumber("Mesh.Binary", 0)
    gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
    gmsh.write(str(OUT / "gmsh41-order2.msh"))


model()
(OUT / "reference.json").write_text(json.dumps(reference()))
by_gmsh()
by_vtk(grid())
by_meshio(grid())
second_order()
gmsh.finalize()
