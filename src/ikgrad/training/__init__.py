"""Training: one loop for networks and ensembles, histories and checkpoints."""

from __future__ import annotations

from ikgrad.training.batches import Batches
from ikgrad.training.checkpoint import load_checkpoint, save_checkpoint
from ikgrad.training.endless import Check, EndlessTraining
from ikgrad.training.history import History, log_epochs
from ikgrad.training.loop import Training, difference
from ikgrad.training.pose_loss import PoseLoss

__all__ = [
    "Batches",
    "Check",
    "EndlessTraining",
    "History",
    "PoseLoss",
    "Training",
    "difference",
    "load_checkpoint",
    "log_epochs",
    "save_checkpoint",
]
