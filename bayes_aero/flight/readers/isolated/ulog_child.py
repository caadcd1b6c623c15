"""The groups of a PX4 ULog file; run by `child.py`."""

import io

import numpy as np
from pyulog import ULog


def groups(data):
    """Every topic and instance with its time stamps."""
    log = ULog(io.BytesIO(data))
    found, without = [], []
    for topic in log.data_list:
        label = topic.name if topic.multi_id == 0 else f"{topic.name}.{topic.multi_id}"
        stamps = topic.data.get("timestamp")
        if stamps is None or stamps.dtype != np.uint64:
            without.append(label)
            continue
        time = (stamps - np.uint64(log.start_timestamp)).view(np.int64) / 1e6  # those before the start are negative
        kinds = {field.field_name: field.type_str for field in topic.field_data}
        columns = [
            ((f"{label}.{name}",), None, values)
            for name, values in topic.data.items()
            if name != "timestamp" and kinds[name] != "char" and "_padding" not in name
        ]
        found.append((label, time, columns))
    remarks = []
    if log.file_corruption:
        remarks.append("the file is damaged in places; the samples that could be read are used")
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts) / 1000.0
        remarks.append(f"the logger lost samples {len(log.dropouts)} times, for {lost:g} s in all")
    if without:
        remarks.append(f"{len(without)} topics have no time stamps and are left out: {', '.join(without[:5])}")
    return found, remarks
