"""A transport table is complete or refused; on disk it is plain arrays."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from render.chebyshev import chebyshev_nodes
from render.errors import TableError
from render.transport import TransportTable, load_table, mean_table

RNG = np.random.default_rng(2)
SHAPE = (4, 5, 3, 2, 6)


def example() -> TransportTable:
    return TransportTable(
        T=RNG.uniform(0, 1, SHAPE),
        se=RNG.uniform(0, 0.01, SHAPE),
        phi=chebyshev_nodes(5, 0.0, np.pi),
        bends=np.radians([0.0, 45.0, 90.0]),
        exposure=100.0,
        lam=2.5,
        scene_hash="0123456789abcdef",
        level="preview",
        background=RNG.uniform(0, 1, SHAPE[:4]),
        background_se=RNG.uniform(0, 0.01, SHAPE[:4]),
        half_difference=RNG.normal(0, 0.01, (*SHAPE[:4], SHAPE[4] + 1)),
    )


def spoiled(array: np.ndarray, value: float) -> np.ndarray:
    array = array.copy()
    array[(1, *[0] * (array.ndim - 1))] = value
    return array


def test_a_table_survives_the_disk_bit_for_bit(tmp_path: Path) -> None:
    table = example()
    table.save(tmp_path / "new folder" / "table.npz")
    loaded = load_table(tmp_path / "new folder" / "table.npz")
    for name, value in vars(table).items():
        np.testing.assert_array_equal(getattr(loaded, name), value)
    assert [item.name for item in (tmp_path / "new folder").iterdir()] == ["table.npz"]


def test_a_background_without_errors_survives_too(tmp_path: Path) -> None:
    replace(example(), background_se=None).save(tmp_path / "table.npz")
    assert load_table(tmp_path / "table.npz").background is not None


def test_a_foreign_table_needs_only_transport_phi_exposure_and_lam(tmp_path: Path) -> None:
    path = tmp_path / "foreign.npz"
    cells = np.ones((7, 1, 1, 2, 3), dtype=np.float32)
    np.savez_compressed(path, T=cells, phi=[0.5], exposure=3, lam=np.float32(0.5))
    table = load_table(path)
    assert table.T.dtype == np.float64
    assert table.exposure == 3.0
    assert not table.se.any()
    assert table.at(np.full(7, 2.0)).shape == (7, 1, 2, 3)


def test_the_halves_of_a_mean_are_the_means_of_halves() -> None:
    parts, samples = [example(), example()], [1.0, 3.0]
    mean = mean_table(parts, samples)
    halves = [
        [part.T + sign * part.half_difference[..., :-1] for part in parts] for sign in (1, -1)
    ]
    for sign, half in zip((1, -1), halves, strict=True):
        np.testing.assert_allclose(
            mean.T + sign * mean.half_difference[..., :-1], np.average(half, 0, samples)
        )
    apart = mean_table([parts[0], replace(parts[1], half_difference=None)], samples)
    assert apart.half_difference is None


def test_at_interpolates_every_fiber_at_its_own_direction() -> None:
    table = example()
    cubic = replace(table, T=np.einsum("fbsk,j->fjbsk", table.T[:, 0], table.phi**3))
    phi = np.array([0.0, 1.0, 2.0, np.pi])
    expected = table.T[:, 0] * phi[:, None, None, None] ** 3
    np.testing.assert_allclose(cubic.at(phi), expected)


@pytest.mark.parametrize("angle", [-1e-9, np.pi + 1e-9, np.nan])
def test_directions_outside_the_table_are_refused(angle: float) -> None:
    with pytest.raises(TableError, match=r"phi = .* allowed: 0 to 3\.14159 rad"):
        example().at(np.array([1.0, 1.0, angle, 1.0]))


@pytest.mark.parametrize("name", ["T", "se", "phi", "bends", "background", "background_se"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_cells_are_refused_and_located(name: str, value: float) -> None:
    table = example()
    with pytest.raises(TableError, match=rf"{name} has 1 non-finite cells, the first at \(1"):
        replace(table, **{name: spoiled(getattr(table, name), value)})


@pytest.mark.parametrize("name", ["se", "phi", "bends", "background", "background_se"])
def test_arrays_that_do_not_match_are_refused(name: str) -> None:
    table = example()
    with pytest.raises(TableError, match=f"{name} has shape"):
        replace(table, **{name: getattr(table, name)[:2]})


def test_axes_must_be_five_and_not_empty() -> None:
    with pytest.raises(TableError, match="five non-empty axes"):
        replace(example(), T=np.ones((4, 5, 3, 2)))
    with pytest.raises(TableError, match="five non-empty axes"):
        replace(example(), T=np.ones((4, 5, 0, 2, 6)))


def test_equal_directions_are_refused() -> None:
    with pytest.raises(TableError, match="equal nodes"):
        replace(example(), phi=np.array([0.0, 1.0, 1.0, 2.0, 3.0]))


@pytest.mark.parametrize("exposure", [0.0, -1.0, np.nan, np.inf])
def test_exposure_must_be_positive_and_finite(exposure: float) -> None:
    with pytest.raises(TableError, match="exposure"):
        replace(example(), exposure=exposure)


@pytest.mark.parametrize("lam", [-1e-9, np.nan, np.inf])
def test_lam_must_not_be_negative(lam: float) -> None:
    with pytest.raises(TableError, match="lam"):
        replace(example(), lam=lam)


def test_the_level_must_be_known() -> None:
    with pytest.raises(
        TableError,
        match="allowed: preview, surrogate, reference",
    ):
        replace(example(), level="guess")


def test_a_missing_file_and_missing_arrays_are_named(tmp_path: Path) -> None:
    with pytest.raises(TableError, match="does not exist"):
        load_table(tmp_path / "none.npz")
    np.savez(tmp_path / "part.npz", T=np.ones(SHAPE))
    with pytest.raises(TableError, match="has no exposure, lam, phi"):
        load_table(tmp_path / "part.npz")


def test_a_pickle_is_never_opened(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return Path.touch, (tmp_path / "sprung",)

    path = tmp_path / "trap.npz"
    np.savez(path, T=np.array([Trap()], dtype=object), phi=[0.0], exposure=1.0, lam=1.0)
    with pytest.raises(TableError, match="not a readable"):
        load_table(path)
    bare = tmp_path / "bare.npz"
    with bare.open("wb") as stream:
        np.save(stream, np.array([Trap()], dtype=object), allow_pickle=True)
    with pytest.raises(TableError, match="not a readable"):
        load_table(bare)
    assert not (tmp_path / "sprung").exists()


def test_other_kinds_of_content_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "odd.npz"
    np.savez(path, T=np.full(SHAPE, "a"), phi=[0.0], exposure=1.0, lam=1.0)
    with pytest.raises(TableError, match="T holds <U1, allowed: real numbers"):
        load_table(path)
    np.savez(path, T=np.ones(SHAPE), phi=np.arange(5.0), exposure=[1.0, 2.0], lam=1.0)
    with pytest.raises(TableError, match="exposure has 2 values"):
        load_table(path)


def test_at_bends_interpolates_every_channel_by_itself() -> None:
    plain = example()
    parts = [example(), example()]
    both = replace(
        plain,
        **{name: np.stack([getattr(one, name) for one in parts], axis=-1) for name in ("T", "se")},
        background=None,
        background_se=None,
        half_difference=None,
    )
    between = np.radians([20.0, 70.0])
    found = both.at_bends(between)
    assert found.by_channel
    for channel, one in enumerate(parts):
        np.testing.assert_allclose(found.T[..., channel], one.at_bends(between).T)
        np.testing.assert_allclose(found.se[..., channel], one.at_bends(between).se)


@given(st.data())
def test_a_damaged_file_is_told_not_crashed_on(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.npz"
    np.savez_compressed(
        path, T=np.ones((1, 1, 1, 1, 3)), phi=np.zeros(1), exposure=np.ones(()), lam=np.ones(())
    )
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.integers(len(content) // 2, len(content)))])
    try:
        assert load_table(path).T.shape == (1, 1, 1, 1, 3)
    except TableError as error:
        assert str(path) in str(error)  # noqa: PT017 - both outcomes are right
