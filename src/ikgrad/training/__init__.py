"""Training: one loop for networks and ensembles, histories and checkpoints."""

from __future__ import annotations

from ikgrad.training.batches import Batches
from ikgrad.training.checkpoint import load_checkpoint, save_checkpoint
from ikgrad.training.history import History, log_epochs
from ikgrad.training.loop import Training, difference

__all__ = ["Batches", "History", "Training", "difference", "load_checkpoint", "log_epochs", "save_checkpoint"]
