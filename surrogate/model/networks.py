"""The residual models: an ensemble of ridge regressions or of small neural networks.

Both map the inputs ``(..., 20)`` of a cell to the coefficients ``(member, ..., 10)`` of
log(T_reference / T_preview) in the basis of the facet normal. All members of an ensemble
are evaluated in one batched matrix product.
"""

from __future__ import annotations

import sys

import torch
from torch import Tensor, nn

# torch's CUDA builds load Triton when an optimizer is made; its LLVM crashes beside those of Mesa
# and Dr.Jit, and nothing here uses it.
sys.modules.setdefault("triton", None)  # type: ignore[arg-type]


class NoResidual(nn.Module):
    """The preview alone: all coefficients are zero (one member)."""

    zeros: Tensor

    def __init__(self, outputs: int) -> None:
        super().__init__()
        self.register_buffer("zeros", torch.zeros(1, outputs))

    def forward(self, x: Tensor) -> Tensor:
        """Return zeros ``(1, ..., outputs)`` that keep NaN."""
        return (0.0 * x[..., :1] * self.zeros)[None]


class RidgeEnsemble(nn.Module):
    """Linear models over the inputs and all their products: ``1, x_i, x_i x_j``.

    Arguments of the constructor:
        weight: ``(member, feature, output)`` over the features of :func:`quadratic`.
    """

    weight: Tensor
    first: Tensor
    second: Tensor

    def __init__(self, weight: Tensor, inputs: int) -> None:
        super().__init__()
        self.register_buffer("weight", weight)
        first, second = torch.triu_indices(inputs, inputs)
        self.register_buffer("first", first)
        self.register_buffer("second", second)

    def forward(self, x: Tensor) -> Tensor:
        """Return the coefficients ``(member, ..., output)``."""
        rows = quadratic(x.reshape(-1, x.shape[-1]), self.first, self.second)
        out = torch.matmul(rows[None], self.weight)
        return out.reshape(self.weight.shape[0], *x.shape[:-1], self.weight.shape[2])


def quadratic(x: Tensor, first: Tensor, second: Tensor) -> Tensor:
    """Return the features ``(row, 1 + inputs + pairs)`` of ``x`` ``(row, inputs)``."""
    products = x.index_select(1, first) * x.index_select(1, second)
    return torch.cat([torch.ones_like(x[:, :1]), x, products], dim=1)


class NetworkEnsemble(nn.Module):
    """Perceptrons with two hidden layers of tanh units, one per member.

    Arguments of the constructor:
        members, inputs, width, outputs: sizes.
        generator: source of the starting weights (scaled by 1 / sqrt(fan in); the last layer
            starts at zero, so that an untrained network is the preview).
    """

    def __init__(
        self, members: int, inputs: int, width: int, outputs: int, generator: torch.Generator
    ) -> None:
        super().__init__()

        def layer(rows: int, columns: int) -> nn.Parameter:
            draw = torch.randn(members, rows, columns, generator=generator)
            return nn.Parameter(draw / rows**0.5)

        def bias(columns: int) -> nn.Parameter:
            return nn.Parameter(torch.zeros(members, columns))

        self.weight1, self.bias1 = layer(inputs, width), bias(width)
        self.weight2, self.bias2 = layer(width, width), bias(width)
        self.weight3, self.bias3 = nn.Parameter(torch.zeros(members, width, outputs)), bias(outputs)

    def forward(self, x: Tensor) -> Tensor:
        """Return the coefficients ``(member, ..., output)``."""
        rows = x.reshape(-1, x.shape[-1])
        members = []
        # One affine map after the other: runtimes fuse each with its bias.
        for w1, b1, w2, b2, w3, b3 in zip(*self.layers(), strict=True):
            hidden = torch.tanh(torch.addmm(b1, rows, w1))
            hidden = torch.tanh(torch.addmm(b2, hidden, w2))
            members.append(torch.addmm(b3, hidden, w3))
        out = torch.stack(members)
        return out.reshape(len(members), *x.shape[:-1], out.shape[-1])

    def layers(self) -> tuple[nn.Parameter, ...]:
        """Return weights and biases from input to output, the member on the first axis."""
        return (
            *(self.weight1, self.bias1),
            *(self.weight2, self.bias2),
            *(self.weight3, self.bias3),
        )
