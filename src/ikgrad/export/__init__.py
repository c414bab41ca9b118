"""Neural inverters for other programs: ONNX and ``torch.export`` files, also with damped steps and a check inside."""

from ikgrad.export.files import Exported, export_inverter, read_metadata
from ikgrad.export.refined import Refined

__all__ = ["Exported", "Refined", "export_inverter", "read_metadata"]
