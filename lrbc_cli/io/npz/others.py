"""Recognises zip archives of other programs by their members, to tell who wrote them and what to export instead."""

from __future__ import annotations

import re
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

from lrbc_cli.errors import DataError, listing
from lrbc_cli.io.common import damaged
from lrbc_cli.io.npz.archive import SIGNATURE


@dataclass(frozen=True, kw_only=True)
class OtherArchive:
    """A zip archive of another program.

    Attributes
    ----------
    program : str
        What it is, in words.
    members : re.Pattern
        Names of members that only these archives have.
    endings : tuple of str
        Endings of the file, where it cannot be opened.
    matrix, frf : str
        What to export instead of a matrix, or instead of a measurement.
    """

    program: str
    members: re.Pattern[str]
    endings: tuple[str, ...]
    matrix: str
    frf: str


_SHEET = {
    "matrix": "save the sheet as text with row, column and value in each line",
    "frf": "save the sheet as CSV: the frequency, then real and imaginary part of each response",
}
_ARCHIVES = (
    OtherArchive(
        program="a model of COMSOL",
        members=re.compile(r"(modelinfo\.xml|[ds]model\.(xml|json)|fileversion|.*\.mphbin)"),
        endings=(".mph",),
        matrix="in COMSOL: mphmatrix and save in LiveLink for MATLAB",
        frf="in COMSOL: write results as text (Export, Table: frequency, real and imaginary part); measured ones come from the analyser",
    ),
    OtherArchive(
        program="a project of Ansys Workbench",
        members=re.compile(r"(.*\.wbpj|(.*/)?dp\d+/.*)"),
        endings=(".wbpz",),
        matrix="in Mechanical, commands after the solution: /AUX2, then HBMAT with mapping; or unpack it, and give its .full file",
        frf="in Mechanical: export the frequency response as text (real and imaginary part); measured ones come from the analyser",
    ),
    OtherArchive(program="an Excel workbook", members=re.compile(r"xl/workbook\.(xml|bin)"), endings=(".xlsx", ".xlsm", ".xlsb"), **_SHEET),
    OtherArchive(
        program="a document of Word", members=re.compile(r"word/document\.xml"), endings=(".docx",), matrix="export text", frf="export text"
    ),
    OtherArchive(program="a document of LibreOffice", members=re.compile(r"content\.xml"), endings=(".ods", ".odt"), **_SHEET),
)
_UNKNOWN = OtherArchive(program="a zip archive", members=re.compile(""), endings=(), matrix="", frf="")


def other_archive(path: Path, start: bytes) -> OtherArchive | None:
    """Program that wrote a zip archive; None for other files and for archives of NumPy, also damaged ones.

    Parameters
    ----------
    path
        The file; its ending is used if it cannot be opened.
    start
        First bytes of the file.
    """
    if not start.startswith(SIGNATURE):
        return None
    try:
        with damaged(path, "zip archive"), zipfile.ZipFile(path) as archive:
            names = [name for name in archive.namelist() if not name.endswith("/")]
    except DataError:
        return next((other for other in _ARCHIVES if path.suffix.lower() in other.endings), None)
    if any(name.endswith(".npy") for name in names):
        return None
    for other in _ARCHIVES:
        if any(map(other.members.fullmatch, names)):
            return other
    unpack = f"unpack it, and give the file that it contains: {listing(names, 4)}"
    return replace(_UNKNOWN, matrix=unpack, frf=unpack)
