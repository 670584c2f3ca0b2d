"""Measurements of a rig as universal files, written by another library than the one that reads them."""

from __future__ import annotations

from pathlib import Path

import pyuff

from lrbc_cli.virtual.chain import Complexes
from rigs.design import Array, Design

HAMMER_NODE, FIRST_MICROPHONE_NODE = 1, 101


def write_uff(path: Path, design: Design, job: str, hits: int, frequencies: Array, estimate: Complexes, coherence: Array) -> None:
    """Write units (164), then FRFs and coherences (58, ASCII, single precision, even spacing)."""
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
        for k, name in enumerate(design.microphones):
            sets.append(
                {
                    "type": 58,
                    "binary": 0,
                    "id1": f"{design.title} {job}",
                    "id2": f"{title} {name}, {hits} hits",
                    "id3": "NONE",
                    "id4": "NONE",
                    "id5": "NONE",
                    "func_type": function,
                    "ver_num": 1,
                    "load_case_id": 0,
                    "rsp_ent_name": name,
                    "rsp_node": FIRST_MICROPHONE_NODE + k,
                    "rsp_dir": 0,
                    "ref_ent_name": "hammer",
                    "ref_node": HAMMER_NODE,
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
                    "ordinate_spec_data_type": 15 if function == 4 else 0,
                    "ordinate_len_unit_exp": 0,
                    "ordinate_force_unit_exp": 0,
                    "ordinate_temp_unit_exp": 0,
                    "ordinate_axis_lab": "Pressure" if function == 4 else "Coherence",
                    "ordinate_axis_units_lab": "Pa" if function == 4 else "NONE",
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
