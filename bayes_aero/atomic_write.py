"""Files and folders that appear whole: written under another name, then renamed.

Folders are flushed before, so that they stay through a loss of power, and so are files where that is asked for.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import socket
from contextlib import suppress
from pathlib import Path

PART, OLD = "part", "old"


def write_whole(content: bytes | memoryview | str, path: Path, *, flush: bool = False) -> Path:
    """Write a file whole or not at all.

    Libraries are given memory to write to, and this writes their bytes: on a full disk some of them (HDF5) crash.

    Raises:
        OSError: with the file's name. An older file of this name is as it was.
    """
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
    """Give a folder that is complete its name, once it is on the disk, in place of what was there. Between the two
    renames a kill leaves that under a hidden name; `sweep` puts it back."""
    for path in (*sorted(made.rglob("*"), reverse=True), made):  # files, their folders, and itself
        sync(path)
    aside = made.with_suffix(f".{OLD}")
    while True:
        shutil.rmtree(aside, ignore_errors=True)
        with suppress(FileNotFoundError):
            os.replace(target, aside)
        try:
            os.replace(made, target)
            break
        except OSError as reason:
            if reason.errno not in (errno.ENOTEMPTY, errno.EEXIST):  # those: another process has just put its own there
                raise
    sync(target.parent)
    shutil.rmtree(aside, ignore_errors=True)


def sync(path: Path) -> None:
    """A file's content, or the names in a folder, on the disk."""
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
    """Remove what processes of this machine that are no more have left half done, and put back what they had moved."""
    for path in folder.glob(".*"):
        name, *parts = path.name[1:].rsplit(".", 3)
        ours = len(parts) == 3 and parts[0] == host() and parts[1].isdigit() and parts[2] in (PART, OLD)
        if not ours:
            continue
        try:
            os.kill(int(parts[1]), 0)
            continue  # it lives
        except ProcessLookupError:
            pass
        except OSError:
            continue
        if parts[2] == OLD and not (folder / name).exists():
            with suppress(OSError):  # a neighbour may sweep too
                os.replace(path, folder / name)
        elif path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def host() -> str:
    """This machine's name, fit for a file's."""
    return re.sub(r"[^A-Za-z0-9-]", "_", socket.gethostname())
