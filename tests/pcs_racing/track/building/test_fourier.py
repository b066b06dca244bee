import numpy as np
import pytest

from pcs_racing.track.building.fourier import transform


@pytest.mark.parametrize("count", [1, 2, 3, 4, 6, 12, 30, 97, 360, 1801, 3072])
def test_the_transform_is_numpys(count):
    rng = np.random.default_rng(count)
    x = rng.normal(size=count) + 1j * rng.normal(size=count)
    real, imaginary = transform(x.real.copy(), x.imag.copy())
    np.testing.assert_allclose(real + 1j * imaginary, np.fft.fft(x), rtol=0, atol=1e-15 * count * np.abs(x).max())
