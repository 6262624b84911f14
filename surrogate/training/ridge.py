"""The baseline residual: ridge regression on the inputs and their products."""

from __future__ import annotations

import numpy as np
import torch

from surrogate.model.networks import RidgeEnsemble, quadratic
from surrogate.training.dataset import MAX_RESIDUAL, RegressionData, expand
from surrogate.training.mlp import deviance

MIN_RATIO = 0.05
"""Darkest T_reference / T_preview that the logarithm is started from."""

SCORING_STEPS = 2
MAX_HALVINGS = 12


def fit_ridge(
    rows: RegressionData, fold: np.ndarray, members: int, penalty: float
) -> RidgeEnsemble:
    """Return ``members`` ridge regressions; member ``m`` does not see the rows of fold ``m``.

    Fisher scoring for the gamma deviance (McCullagh and Nelder 1989, 2.5): least squares for the
    working response ``z = r + y exp(-r) - 1``, which starts at log y. A step that would raise the
    deviance, as noisy ratios make it do, is halved until it lowers it. The target of a row is the
    weighted projection of its responses on the basis of the normal; rows count by the mean weight
    of their cells. ``penalty`` multiplies the squared weights of the standardized features (Hoerl
    and Kennard 1970).
    """
    from sklearn.linear_model import Ridge

    row_weight = rows.weight.mean(dim=1).double().numpy()
    inputs = rows.x.shape[1]
    first, second = torch.triu_indices(inputs, inputs)
    features = quadratic(rows.x.double(), first, second).numpy()[:, 1:]
    center, scale = features.mean(axis=0), np.maximum(features.std(axis=0), 1e-6)
    standardized = (features - center) / scale
    index = rows.fold_rows(fold).numpy()
    start = _project(rows, torch.log(torch.clamp(rows.ratio, min=MIN_RATIO)))
    weights = []
    for member in range(members):
        seen, target = index != member, start
        kept, least = None, np.inf
        for _ in range(1 + SCORING_STEPS):
            model = Ridge(alpha=penalty * row_weight[seen].sum())
            model.fit(standardized[seen], target[seen], sample_weight=row_weight[seen])
            found = np.concatenate([model.intercept_[None], model.coef_.T])
            for _ in range(MAX_HALVINGS):
                residual = expand(_linear(standardized, found), rows.basis)
                # A weak penalty lets few noisy rows reach farther than an exponential does.
                residual = residual.clamp(-MAX_RESIDUAL, MAX_RESIDUAL)
                loss = float((rows.weight * deviance(rows.ratio, residual))[seen].sum())
                if kept is None or loss < least:
                    break
                found = 0.5 * (found + kept)
            else:
                break
            kept, least = found, loss
            target = _project(rows, residual + rows.ratio * torch.exp(-residual) - 1.0)
        assert kept is not None  # the first step is always taken
        slope = kept[1:] / scale[:, None]
        weights.append(np.concatenate([kept[:1] - center @ slope, slope]))
    return RidgeEnsemble(torch.as_tensor(np.array(weights), dtype=torch.float32), inputs)


def _linear(features: np.ndarray, weights: np.ndarray) -> torch.Tensor:
    """Return ``(row, output)``; the first row of ``weights`` is the constant."""
    return torch.as_tensor(features @ weights[1:] + weights[0], dtype=torch.float32)


def _project(rows: RegressionData, response: torch.Tensor) -> np.ndarray:
    """Return the coefficients ``(row, output)`` that fit ``response`` row by row, in its frame."""
    basis = rows.basis.double()
    weighted = basis * rows.weight[:, None, :].double()
    gram = weighted @ basis.transpose(1, 2)
    # Contrast terms can be collinear with the harmonics: a trace of the weight keeps them apart.
    gram = gram + 1e-3 * rows.weight.mean() * torch.eye(basis.shape[1], dtype=torch.float64)
    right = weighted @ response[:, :, None].double()
    return np.asarray(torch.linalg.solve(gram, right)[..., 0].numpy())
