"""An inverter with damped steps and a check behind it, in torch operations that every exporter knows."""

from __future__ import annotations

from torch import Tensor, nn

from ikgrad.networks.storage import AnyInverter
from ikgrad.solvers.damped import DAMPING, damped_steps, typical_length


class Refined(nn.Module):
    r"""An inverter's answer, improved by k damped steps and measured by forward kinematics.

    Steps are those of `ikgrad.solvers.damped`: Levenberg-Marquardt, joints at a limit with an outward gradient left
    out of J, cut at 0.8 rad a joint and at the limits,

        dq = J^T (J J^T + mu I)^-1 e,   mu = 0.1 |e|^2 + 1e-12

    Steps and check are done in float64, whatever the dtype of the network, and nothing is differentiable. There are no
    restarts: what does not converge is told by the errors. On the CPU the kernels run here, while an exported graph
    holds torch operations; so the comparison of `export_inverter` is one of two implementations.

    Args:
        inverter: the network; its robot is the one whose kinematics are used.
        steps: k, at least 0.

    Example:
        >>> import ikgrad as ik
        >>> robot = ik.load_robot("ur5e")
        >>> q = ik.sample_configurations(robot, 20, seed=0)
        >>> T = ik.forward_kinematics(robot, q)
        >>> refined = Refined(ik.UnrolledInverter(robot), steps=2)
        >>> answer, position_error, rotation_error = refined(T, q + 0.1)
        >>> answer.shape, position_error.shape
        (torch.Size([20, 6]), torch.Size([20]))
    """

    def __init__(self, inverter: AnyInverter, *, steps: int):
        super().__init__()
        self.inverter, self.steps = inverter, steps
        self.robot = inverter.robot.detach()
        self.length = typical_length(self.robot)

    def forward(self, T: Tensor, q_current: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """Improved joints and what is still missing.

        Args:
            T: (..., 4, 4) wanted poses [m].
            q_current: (..., n) present joints, for an inverter that looks at them.

        Returns:
            (..., n) joints, of the dtype of ``T``; (...) position error [m]; (...) rotation error [rad].
        """
        q = self.inverter(T) if q_current is None else self.inverter(T, q_current)
        at = damped_steps(self.robot, T.double(), q.double(), steps=self.steps, damping=DAMPING)
        answer = at.q.to(T.dtype)
        if answer.dtype != at.q.dtype:  # the errors are those of the rounded joints, which are handed out
            at = damped_steps(self.robot, T.double(), answer.double())
        squares = at.error.square().unflatten(-1, (2, 3)).sum(dim=-1)
        position, rotation = squares.sqrt().unbind(dim=-1)
        return answer, (position * position.new_tensor(self.length)).to(T.dtype), rotation.to(T.dtype)


__all__ = ["Refined"]
