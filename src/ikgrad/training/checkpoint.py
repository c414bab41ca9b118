"""Checkpoints: one file, written at one go, checked when it is read."""

from __future__ import annotations

import hashlib
import io
import pickle
from pathlib import Path
from typing import Any

import torch

from ikgrad.errors import DataError
from ikgrad.files.places import in_one_move

_MAGIC = b"ikgrad checkpoint 1\n"


def save_checkpoint(path: str | Path, state: dict[str, Any]) -> None:
    """Write a nested dictionary of tensors and plain values, so that a kill at any time leaves the old file or the new.

    Args:
        path: the file; replaced if it exists.
        state: what `load_checkpoint` gives back.

    Raises:
        DataError: the file cannot be written; an older one is still whole.
    """
    buffer = io.BytesIO()
    torch.save(state, buffer)
    body = buffer.getvalue()
    try:
        with in_one_move(Path(path), force=True) as temporary:
            temporary.write_bytes(_MAGIC + hashlib.sha256(body).hexdigest().encode() + b"\n" + body)
    except OSError as error:
        raise DataError(f"{path}: cannot write the checkpoint: {error.strerror}") from error


def load_checkpoint(path: str | Path) -> dict[str, Any]:
    """Read what `save_checkpoint` wrote; nothing in it is executed.

    Raises:
        DataError: the file cannot be read, is no checkpoint, or is not what was written.
    """
    path = Path(path)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot read the checkpoint: {error.strerror}") from error
    if not content.startswith(_MAGIC):
        raise DataError(f"{path}: is not a checkpoint of this version of ikgrad")
    digest, _, body = content[len(_MAGIC) :].partition(b"\n")
    if hashlib.sha256(body).hexdigest().encode() != digest:
        raise DataError(f"{path}: the checkpoint is truncated or was changed; delete it to start anew")
    try:
        return torch.load(io.BytesIO(body), weights_only=True)
    except (RuntimeError, pickle.UnpicklingError) as error:  # a right checksum over something else
        raise DataError(f"{path}: the checkpoint cannot be read: {str(error).splitlines()[0]}") from error


__all__ = ["load_checkpoint", "save_checkpoint"]
