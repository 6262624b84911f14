"""The baseline residual: ridge regression on the inputs and their products."""

from __future__ import annotations

import numpy as np
import torch

from surrogate.networks import RidgeEnsemble, quadratic
from surrogate.rows import Rows


def fit_ridge(rows: Rows, fold: np.ndarray, members: int, penalty: float) -> RidgeEnsemble:
    """Return ``members`` ridge regressions; member ``m`` does not see the rows of fold ``m``.

    The target of a row is the weighted least-squares projection of its log ratios on the basis of
    the normal; rows count by the mean weight of their cells. ``penalty`` multiplies the squared
    weights of the standardised features (Hoerl and Kennard 1970).
    """
    from sklearn.linear_model import Ridge

    coefficients = _project(rows)
    row_weight = rows.weight.mean(dim=1).double().numpy()
    inputs = rows.x.shape[1]
    first, second = torch.triu_indices(inputs, inputs)
    features = quadratic(rows.x.double(), first, second).numpy()[:, 1:]
    center, scale = features.mean(axis=0), np.maximum(features.std(axis=0), 1e-6)
    standardised = (features - center) / scale
    index = rows.fold_rows(fold).numpy()
    weights = []
    for member in range(members):
        seen = index != member
        model = Ridge(alpha=penalty * row_weight[seen].sum())
        model.fit(standardised[seen], coefficients[seen], sample_weight=row_weight[seen])
        slope = model.coef_.T / scale[:, None]
        constant = model.intercept_ - center @ slope
        weights.append(np.concatenate([constant[None], slope]))
    return RidgeEnsemble(torch.as_tensor(np.array(weights), dtype=torch.float32), inputs)


def _project(rows: Rows) -> np.ndarray:
    """Return the coefficients ``(row, output)`` that fit every row on its own, in its frame."""
    basis = rows.basis.double()
    weighted = basis * rows.weight[:, None, :].double()
    gram = weighted @ basis.transpose(1, 2) + 1e-3 * torch.eye(basis.shape[1], dtype=torch.float64)
    right = weighted @ rows.target[:, :, None].double()
    return np.asarray(torch.linalg.solve(gram, right)[..., 0].numpy())
