"""Whole epochs at a time on the compiled CPU kernels, for small networks and the classical rules.

Weights and the optimizer's state go in and come out as the torch path would leave them, a file of either path can be
continued by the other, and random orders come from the same generators. Only the rounding differs, by the order of
additions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ikgrad.networks import MLP
from ikgrad.optim import Backprop, DeltaBarDelta, Quickprop
from ikgrad.training.batches import Batches

if TYPE_CHECKING:
    from ikgrad.training.loop import Training

_ACTIVATIONS = {"linear", "logistic", "tanh", "relu"}  # as the engine has them; asking it would import Numba
_SECONDS_A_CHUNK = 0.1
_SECONDS_A_WEIGHT = 4e-9  # of eight networks, roughly, for one pattern


class _Job(NamedTuple):
    """An optimizer's rule in the words of the engine."""

    rule: str
    settings: tuple[float, ...]
    start: dict[str, float]  # the names of its tensors in the order of the engine, and what fills new ones


def serves(training: Training) -> bool:
    """True if the kernels can run this training, to the same end as torch.

    They cannot where somebody looks on at every step: a learning-rate scheduler or a hook of the optimizer.
    """
    network, optimizer, data = training.network, training.optimizer, training.data
    if type(network) is not MLP or type(optimizer) not in _JOBS or len(optimizer.param_groups) != 1:
        return False
    group, parameters = optimizer.param_groups[0], list(network.parameters())
    watched = "initial_lr" in group or optimizer._optimizer_step_pre_hooks or optimizer._optimizer_step_post_hooks
    tensors = [*parameters, data.x, data.y]
    return (
        not watched
        and {network.hidden, network.output} <= _ACTIVATIONS
        and [*map(id, group["params"])] == [*map(id, parameters)]
        and all(tensor.dtype == torch.float64 and tensor.device.type == "cpu" for tensor in tensors)
        and _fits(network, data)
    )


def _fits(network: MLP, data: Batches) -> bool:
    """Whether torch would pair networks, inputs and targets as the kernels do, without broadcasting."""
    lead = data.x.shape[:-2]
    stacked = lead == () or (network.members is not None and lead in ((1,), (network.members,)))
    return stacked and (data.x.shape[-1], data.y.shape[-1]) == (network.sizes[0], network.sizes[-1])


def run(training: Training, most: int) -> int:
    """Train for about a tenth of a second, which suits progress and interrupts; `serves` must hold.

    Returns:
        epochs done, at least one and not more than ``most``. If it is interrupted nothing has changed.
    """
    from ikgrad.engine import perceptron

    network, optimizer, data = training.network, training.optimizer, training.data
    assert isinstance(network, MLP)
    epochs = min(most, _epochs_a_chunk(network, data))
    job = _JOBS[type(optimizer)](optimizer.param_groups[0], optimizer.state.get(network.weights[0], {}))
    parameters, members = _by_layer(network), network.members or 1
    before = data.state_dict()
    try:
        order = data.orders(epochs)
        weights, memory = perceptron.train(
            job.rule,
            job.settings,
            network.sizes,
            [network.hidden] * (len(network.sizes) - 2) + [network.output],
            _flat(parameters, members),
            _memory(optimizer, parameters, members, job),
            torch.cat([data.y, data.x], -1).reshape(-1, data.count, data.y.shape[-1] + data.x.shape[-1]).numpy(),
            None if order is None else order.numpy(),
            epochs=epochs,
            batch_size=data.batch_size,
            threads=torch.get_num_threads(),
        )
    except BaseException:
        data.load_state_dict(before)
        raise
    _write(parameters, weights)
    for name, values in zip(job.start, memory, strict=True):
        _write([optimizer.state[parameter][name] for parameter in parameters], values)
    return epochs


def _epochs_a_chunk(network: MLP, data: Batches) -> int:
    members = network.members or 1
    weights = sum(parameter.numel() for parameter in network.parameters()) // members
    return max(1, int(_SECONDS_A_CHUNK / (_SECONDS_A_WEIGHT * weights * -(-members // 8) * data.count)))


def _by_layer(network: MLP) -> list[Tensor]:
    """Parameters in the order of the engine: weights, then biases, of one layer after the other."""
    return [parameter for pair in zip(network.weights, network.biases, strict=True) for parameter in pair]


def _flat(tensors: Sequence[Tensor], members: int) -> NDArray[np.float64]:
    """(S, P) all numbers of each network."""
    return torch.cat([tensor.detach().reshape(members, -1) for tensor in tensors], 1).numpy()


def _memory(optimizer: torch.optim.Optimizer, parameters: list[Tensor], members: int, job: _Job) -> Any:
    """(Q, S, P) the rule's tensors; those that the optimizer does not have yet are put there as the rule would."""
    for parameter in parameters:
        state = optimizer.state[parameter]
        if job.rule == "delta_bar_delta" and not state:
            state["lr_start"] = job.start["rate"]
        for name, value in job.start.items():
            if name not in state:
                state[name] = torch.full_like(parameter.detach(), value)
    tensors = [[optimizer.state[parameter][name] for parameter in parameters] for name in job.start]
    flat = [_flat(each, members) for each in tensors]
    return np.stack(flat) if flat else np.empty((0, members, _flat(parameters, members).shape[1]))


@torch.no_grad()
def _write(tensors: Sequence[Tensor], values: NDArray[np.float64]) -> None:
    members = len(values)
    parts = torch.from_numpy(values).split([tensor.numel() // members for tensor in tensors], 1)
    for tensor, part in zip(tensors, parts, strict=True):
        tensor.copy_(part.reshape(tensor.shape))


def _backprop(group: dict[str, Any], state: dict[str, Any]) -> _Job:
    names = {"momentum_buffer": 0.0} if group["momentum"] > 0.0 else {}
    return _Job("backprop", (group["lr"], group["momentum"]), names)


def _delta_bar_delta(group: dict[str, Any], state: dict[str, Any]) -> _Job:
    begun = state.get("lr_start", float(group["lr"]))
    schedule = group["lr"] / begun if begun > 0.0 else 1.0
    names = {"rate": begun, "trace": 0.0} | ({"last_step": 0.0} if group["momentum"] > 0.0 else {})
    settings = (schedule, group["kappa"], group["phi"], group["theta"], group["momentum"])
    return _Job("delta_bar_delta", settings, names)


def _quickprop(group: dict[str, Any], state: dict[str, Any]) -> _Job:
    names = {"last_step": 0.0, "last_slope": 0.0}
    if group["literal"]:
        return _Job("printed_quickprop", (group["lr"],), names)
    return _Job("quickprop", (group["lr"], group["mu"], group["weight_decay"], group["max_step"]), names)


_JOBS: dict[type, Any] = {Backprop: _backprop, DeltaBarDelta: _delta_bar_delta, Quickprop: _quickprop}
