"""Run one of the parsers beside it (`*_child.py`) in this process. Run as a script, never imported by the package.

On damaged bytes such parsers loop for ever, crash or take all memory, and nothing interrupts them from inside (the
HDF5 library is C code; fuzzing soon found files on which it loops). The parent, `process.py`, gives this process a time
limit instead.

In: the file on stdin, the path of the parser in argv[1], a request as JSON in argv[2]. The parser has a function
`answer(data, *request)`, which gives a reply for JSON and the arrays behind it; or a function `groups(data)`, which
gives a list of groups and a list of remarks. A group is a name, (n,) seconds from the file's start, and columns: names,
unit or None, and (n,) numbers; the request is the most bytes of all arrays, and the most columns.
Out: one line of JSON, then the arrays in its order. Failures: {"error": ...} or {"refused": ...}.
"""

import json
import os
import runpy
import sys
import warnings
from contextlib import redirect_stdout, suppress

import numpy as np

MEMORY = 8 << 30  # bytes of address space for this process; a damaged header may ask for any amount


def _packed(values):
    """An array in the byte order of this machine."""
    return values.astype(values.dtype.newbyteorder("="), copy=False)


def _described(groups, remarks, most_bytes, most_columns):
    """The reply on groups, and the arrays that follow it."""
    listed, arrays = [], []
    for name, time, columns in groups:
        described = [[[str(n)[:200] for n in names], unit, _packed(v[:0]).dtype.str] for names, unit, v in columns]
        listed.append({"name": str(name)[:200], "size": len(time), "columns": described})
        arrays += [np.asarray(time, np.float64), *(values for _, _, values in columns)]
    if sum(len(columns) for _, _, columns in groups) > most_columns:
        return {"refused": f"it has more than {most_columns} columns; is it a flight record?"}, []
    claimed = sum(array.nbytes for array in arrays)
    if claimed > most_bytes:
        return {"refused": f"it unpacks to {claimed} bytes, more than {most_bytes}; cut the record"}, []
    return {"groups": listed, "remarks": [str(remark)[:500] for remark in remarks]}, arrays


def main():
    with suppress(ImportError, ValueError, OSError):  # not every platform can
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    warnings.simplefilter("ignore")
    arrays: list = []
    out = sys.stdout.buffer
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):  # some of them print what they think of the file
        try:
            parser, data, request = runpy.run_path(sys.argv[1]), sys.stdin.buffer.read(), json.loads(sys.argv[2])
            if "answer" in parser:
                reply, arrays = parser["answer"](data, *request)
            else:
                reply, arrays = _described(*parser["groups"](data), *request)
        except Exception as reason:
            reply = {"error": " ".join(str(reason).split())[:120] or type(reason).__name__}
    out.write(json.dumps(reply).encode() + b"\n")
    for array in arrays:
        out.write(_packed(array).tobytes())
    out.flush()


if __name__ == "__main__":
    main()
