"""Kernels of the chain against the plain torch functions."""

import numpy as np
import pytest
import torch

from ikgrad import engine
from ikgrad.data import sample_configurations
from ikgrad.kinematics import plain_forward_kinematics, pose_and_jacobian


@pytest.mark.parametrize("rows", [1, 7, 8, 21])
def test_kernels_agree_with_torch(robot, rows):
    q = sample_configurations(robot, rows, seed=rows).requires_grad_()
    T, J = pose_and_jacobian(robot, q)
    grad_T = torch.randn(T.shape, dtype=T.dtype, generator=torch.Generator().manual_seed(0))
    (grad_q,) = torch.autograd.grad(T, q, grad_T)
    chain, values = engine.pack(robot), q.detach().numpy()
    np.testing.assert_allclose(engine.fk(chain, values), T.detach().numpy(), atol=1e-12)
    np.testing.assert_allclose(engine.jacobian(chain, values), J.detach().numpy(), atol=1e-12)
    np.testing.assert_allclose(engine.fk_vjp(chain, values, grad_T.numpy()), grad_q.numpy(), atol=1e-11)


@pytest.mark.parametrize("size", [1e2, 1e3, 1e5, 1e7])
def test_large_angles_keep_their_digits(panda, size):
    q = torch.linspace(-size, size, 7 * 40, dtype=torch.float64).reshape(40, 7)
    T = plain_forward_kinematics(panda, q).numpy()
    np.testing.assert_allclose(engine.fk(engine.pack(panda), q.numpy()), T, atol=1e-13 * max(1.0, size * 1e-2))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_bad_row_is_nan_and_harms_no_other(robot, bad):
    q = sample_configurations(robot, 19, seed=0).numpy()
    chain = engine.pack(robot)
    good = engine.fk(chain, q), engine.jacobian(chain, q), engine.fk_vjp(chain, q, np.ones((19, 4, 4)))
    q[11] = bad
    now = engine.fk(chain, q), engine.jacobian(chain, q), engine.fk_vjp(chain, q, np.ones((19, 4, 4)))
    others = np.arange(19) != 11
    for a, b in zip(good, now, strict=True):
        np.testing.assert_array_equal(a[others], b[others])
    assert np.isnan(now[0][11]).any()


def test_rows_are_bit_identical_wherever_they_stand(robot):
    q = sample_configurations(robot, 53, seed=0).numpy()
    chain, order = engine.pack(robot), np.random.default_rng(0).permutation(53)
    grad_T = np.random.default_rng(1).normal(size=(53, 4, 4))
    for f in (engine.fk, engine.jacobian):
        whole = f(chain, q, threads=2)
        np.testing.assert_array_equal(f(chain, q[order]), whole[order])
        np.testing.assert_array_equal(np.concatenate([f(chain, row[None]) for row in q]), whole)
    whole = engine.fk_vjp(chain, q, grad_T)
    np.testing.assert_array_equal(engine.fk_vjp(chain, q[order], grad_T[order], threads=2), whole[order])


def test_no_rows_give_no_rows(robot):
    chain, none = engine.pack(robot), np.empty((0, robot.dof))
    assert engine.fk(chain, none).shape == (0, 4, 4)
    assert engine.jacobian(chain, none).shape == (0, 6, robot.dof)
    assert engine.fk_vjp(chain, none, np.empty((0, 4, 4))).shape == (0, robot.dof)
