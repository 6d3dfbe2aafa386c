"""The recordings of the rotations as the paper files them: X+1080 and X-1080, trimmed to equal length."""

from __future__ import annotations

from io import StringIO

import numpy as np

from bench.systems.gnc.calibration.fitted import Calibration
from bench.systems.gnc.folders import folder_name
from bench.systems.gnc.sets import rotation_record

_HEAD = "counter,time_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"


def rotation_files(calibration: Calibration, serial: str) -> dict[str, str]:
    """Relative path to text: ``<serial>/gyro/X+1080.csv`` ...; those the fit refused are not cut and not filed."""
    if calibration.gyro is None:
        return {}
    files = {}
    for row in calibration.sets.rotations.values():
        record = rotation_record(row)
        used = calibration.gyro.used[record.name]
        first = np.concatenate([[True], np.diff(record.counter) != 0])  # samples that came twice stand there once
        table = np.column_stack([record.time_s, record.rate])[first][:used]
        files[f"{folder_name(serial)}/gyro/{record.name}.csv"] = _csv(record.counter[first][:used], table)
    return files


def _csv(
    counter: np.ndarray[tuple[int], np.dtype[np.int64]], table: np.ndarray[tuple[int, int], np.dtype[np.float64]]
) -> str:
    text = StringIO()
    text.write(_HEAD + "\n")
    for number, values in zip(counter.tolist(), table.tolist(), strict=True):
        text.write(f"{number},{values[0]:.6f},{values[1]:.6g},{values[2]:.6g},{values[3]:.6g}\n")
    return text.getvalue()
