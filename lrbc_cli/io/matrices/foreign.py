"""Recognises files of other programs without a readable matrix, to tell who wrote them and what to export instead."""

from __future__ import annotations

import re
from pathlib import Path

from lrbc_cli.io.hdf5.layouts import MESH
from lrbc_cli.io.npz.others import other_archive

_ABAQUS = "in Abaqus: *MATRIX GENERATE, STIFFNESS, MASS and *MATRIX OUTPUT, STIFFNESS, MASS, FORMAT=MATRIX INPUT in a step of its own"
_ANSYS = "in Ansys: /AUX2, then HBMAT with mapping, or *SMAT and *EXPORT,...,MMF"
_NASTRAN = "in Nastran: EXTSEOUT(STIFFNESS,MASS,DMIGPCH), or OUTPUT4 of KAA and MAA"
_COMSOL = "in COMSOL: mphmatrix and save in LiveLink for MATLAB"

#: First bytes of a file, the program that wrote it, and what to do.
_STARTS: tuple[tuple[bytes, str, str], ...] = (
    (b"CDF", "an exodus mesh or another netCDF file", MESH),
    (b"$MeshFormat", "a mesh of gmsh", MESH),
    (b"*HEADING", "an input file of Abaqus or CalculiX, not a matrix", _ABAQUS),
    (b"*NODE", "an input file of Abaqus or CalculiX, not a matrix", MESH),
    (b"*", "an input file of Abaqus or CalculiX, not a matrix", _ABAQUS),
    (b"/COM", "an input file of Ansys, not a matrix", _ANSYS),
    (b"<?xml", "a file in XML", "export matrices as text"),
)

#: Substructure or element matrices: dense triangles under keywords, or entries that begin with the number of an element.
_OF_ELEMENTS = re.compile(rb"(?:\s*\*\*.*\n)*\s*(?:\*USER ELEMENT|(?:-?\d+\s*,\s*){5}[-+.\d])", re.IGNORECASE)

#: Program and advice by the ending of the name, for files that the content does not identify.
_ENDINGS: dict[str, tuple[str, str]] = {
    ".odb": ("a database of Abaqus", _ABAQUS),
    ".sim": ("a database of Abaqus", _ABAQUS),
    ".rst": ("a result file of Ansys", _ANSYS),
    ".emat": ("element matrices of Ansys", _ANSYS),
    ".sub": ("a superelement of Ansys", _ANSYS),
    ".db": ("a database of Ansys", _ANSYS),
    ".op2": ("a result file of Nastran", _NASTRAN),
    ".bdf": ("an input file of Nastran, not a matrix", _NASTRAN),
    ".dat": ("perhaps an input file, not a matrix", _NASTRAN),
    ".mph": ("a model of COMSOL", _COMSOL),
    ".frd": ("results of CalculiX", "in CalculiX: *FREQUENCY, SOLVER=MATRIXSTORAGE writes .sti, .mas and .dof"),
    ".unv": ("a universal file", "export the matrices; measurements in universal files belong under jobs"),
    ".uff": ("a universal file", "export the matrices; measurements in universal files belong under jobs"),
}


def of_elements(start: bytes) -> bool:
    """Whether a file has Abaqus ``*ELEMENT`` or ``*SUBSTRUCTURE MATRIX OUTPUT``, or entries element by element, by its first bytes."""
    return bool(_OF_ELEMENTS.match(start))


def written_by(path: Path, start: bytes) -> tuple[str | None, str]:
    """Program that wrote a file (None if unknown), and what to export instead.

    Parameters
    ----------
    path
        The file; its name is used if the content does not identify it.
    start
        First bytes of the file.
    """
    archive = other_archive(path, start)
    if archive is not None:
        return archive.program, archive.matrix
    if of_elements(start):
        return "a substructure or single elements of Abaqus, not an assembled matrix", _ABAQUS
    first = start.lstrip().upper()
    for mark, program, hint in _STARTS:
        if first.startswith(mark.upper()):
            return program, hint
    found = _ENDINGS.get(path.suffix.lower())
    return found if found else (None, "`lrbc guide export` says how to export matrices from each FE program")
