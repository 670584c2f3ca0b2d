"""Measurements of a rig as universal files, written by another library than the one that reads them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyuff
from numpy.typing import NDArray

from lrbc_cli.virtual.chain import Complexes

HAMMER_NODE, FIRST_SENSOR_NODE = 1, 101

#: Type of ordinate data (data set 58), its label and its unit.
PRESSURE, ACCELERATION = (15, "Pressure", "Pa"), (12, "Acceleration", "m/s2")


@dataclass(frozen=True)
class Header:
    """What stands above the numbers.

    Attributes
    ----------
    title : str
        Of rig and job.
    hits : int
    responses : mapping of str to str
        The hammer of each response.
    quantity : (int, str, str)
        ``PRESSURE`` or ``ACCELERATION``.
    """

    title: str
    hits: int
    responses: Mapping[str, str]
    quantity: tuple[int, str, str] = PRESSURE


def write_uff(path: Path, header: Header, frequencies: NDArray[np.float64], estimate: Complexes, coherence: NDArray[np.float64]) -> None:
    """Write units (164), then FRFs and coherences (58, ASCII, single precision, even spacing)."""
    kind, label, unit = header.quantity
    hammers = list(dict.fromkeys(header.responses.values()))
    units = {
        "type": 164,
        "units_code": 1,
        "units_description": "SI",
        "temp_mode": 1,
        "length": 1.0,
        "force": 1.0,
        "temp": 1.0,
        "temp_offset": 273.15,
    }
    sets = [units]
    for function, title, values in ((4, "Frequency Response Function", estimate), (6, "Coherence", coherence)):
        for k, name in enumerate(header.responses):
            sets.append(
                {
                    "type": 58,
                    "binary": 0,
                    "id1": header.title,
                    "id2": f"{title} {name}, {header.hits} hits",
                    "id3": "NONE",
                    "id4": "NONE",
                    "id5": "NONE",
                    "func_type": function,
                    "ver_num": 1,
                    "load_case_id": 0,
                    "rsp_ent_name": name,
                    "rsp_node": FIRST_SENSOR_NODE + k,
                    "rsp_dir": 0,
                    "ref_ent_name": header.responses[name],
                    "ref_node": HAMMER_NODE + hammers.index(header.responses[name]),
                    "ref_dir": 3,
                    "ord_data_type": 5 if function == 4 else 2,
                    "num_pts": frequencies.size,
                    "abscissa_spacing": 1,
                    "abscissa_min": float(frequencies[0]),
                    "abscissa_inc": float(frequencies[1] - frequencies[0]),
                    "z_axis_value": 0.0,
                    "abscissa_spec_data_type": 18,
                    "abscissa_len_unit_exp": 0,
                    "abscissa_force_unit_exp": 0,
                    "abscissa_temp_unit_exp": 0,
                    "abscissa_axis_lab": "Frequency",
                    "abscissa_axis_units_lab": "Hz",
                    # A coherence is the ratio of two powers: type 0 (unknown) has no unit.
                    "ordinate_spec_data_type": kind if function == 4 else 0,
                    "ordinate_len_unit_exp": 0,
                    "ordinate_force_unit_exp": 0,
                    "ordinate_temp_unit_exp": 0,
                    "ordinate_axis_lab": label if function == 4 else "Coherence",
                    "ordinate_axis_units_lab": unit if function == 4 else "NONE",
                    "orddenom_spec_data_type": 13 if function == 4 else 0,
                    "orddenom_len_unit_exp": 0,
                    "orddenom_force_unit_exp": 0,
                    "orddenom_temp_unit_exp": 0,
                    "orddenom_axis_lab": "Force" if function == 4 else "NONE",
                    "orddenom_axis_units_lab": "N" if function == 4 else "NONE",
                    "z_axis_spec_data_type": 0,
                    "z_axis_len_unit_exp": 0,
                    "z_axis_force_unit_exp": 0,
                    "z_axis_temp_unit_exp": 0,
                    "z_axis_axis_lab": "NONE",
                    "z_axis_axis_units_lab": "NONE",
                    "x": frequencies,
                    "data": values[:, k],
                }
            )
    path.unlink(missing_ok=True)
    pyuff.UFF(str(path)).write_sets(sets, mode="add", force_double=False)
