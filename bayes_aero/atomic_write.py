"""Files and folders that appear whole: written under another name, then renamed.

Folders are flushed before, so that they stay through a loss of power, and so are files where that is asked for.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import socket
from pathlib import Path

PART = "part"


def write_whole(content: bytes | memoryview | str, path: Path, *, flush: bool = False) -> Path:
    """Write a file whole or not at all. Libraries are given memory to write to, and this writes their bytes: on a full
    disk some of them (HDF5) crash. `OSError` has the file's name; an older file of this name is as it was."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.{PART}")
    try:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)
        if flush:
            sync(partial)
        os.replace(partial, path)
    except OSError as reason:
        raise OSError(reason.errno, reason.strerror or str(reason), str(path)) from None
    finally:
        partial.unlink(missing_ok=True)
    return path


def beside(target: Path) -> Path:
    """The name under which this process makes `target`: hidden, and telling which process of which machine."""
    return target.with_name(f".{target.name}.{host()}.{os.getpid()}.{PART}")


def put_folder(made: Path, target: Path) -> None:
    """Give a folder that is complete its name, once it is on the disk, in place of what was there."""
    for path in (*sorted(made.rglob("*"), reverse=True), made):  # files, their folders, and itself
        sync(path)
    while True:
        shutil.rmtree(target, ignore_errors=True)
        try:
            os.replace(made, target)
            break
        except OSError as reason:
            if reason.errno not in (errno.ENOTEMPTY, errno.EEXIST):  # those: another process has just put its own there
                raise
    sync(target.parent)


def sync(path: Path) -> None:
    if path.is_dir() and not hasattr(os, "O_DIRECTORY"):
        return  # Windows neither can nor need
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as reason:
        if reason.errno != errno.EINVAL:  # a file system that cannot flush folders
            raise
    finally:
        os.close(handle)


def sweep(folder: Path) -> None:
    """Remove what processes of this machine that are no more have left half done."""
    for path in folder.glob(f".*.{host()}.*.{PART}"):
        number = path.name.split(".")[-2]
        try:
            if number.isdigit():
                os.kill(int(number), 0)
            continue  # it lives
        except ProcessLookupError:
            pass
        except OSError:
            continue
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def host() -> str:
    return re.sub(r"[^A-Za-z0-9-]", "_", socket.gethostname())
