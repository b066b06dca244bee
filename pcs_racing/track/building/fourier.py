"""The discrete Fourier transform with the same bits on every processor.

Numpy's transform uses the sines of the C library, which selects its code by the processor. This is the mixed-radix
transform in Stockham's order (Van Loan 1992, *Computational Frameworks for the Fast Fourier Transform*, 1.7).
"""

import numpy as np

from pcs_racing.base.compilation import compiled
from pcs_racing.base.elementary import sine_cosine


@compiled
def transform(real, imaginary):  # type: ignore[no-untyped-def]
    """Return ``X[k] = sum_j x[j] exp(-2 pi i j k / N)`` for any N, in N times the sum of its prime factors operations.

    Parameters
    ----------
    real, imaginary : ndarray, shape (N,)
        Real and imaginary part of x.

    Returns
    -------
    real, imaginary : ndarray, shape (N,)
        Real and imaginary part of X.
    """
    n = real.shape[0]
    sine = np.empty(n)
    cosine = np.empty(n)
    for k in range(n):
        sine[k], cosine[k] = sine_cosine(-2.0 * np.pi * k / n)
    re, im = real.copy(), imaginary.copy()
    next_re, next_im = np.empty(n), np.empty(n)
    done = 1  # values already combined into one
    left = n
    radix = 2
    while left > 1:
        while left % radix != 0:
            radix = radix + 1 if radix * radix <= left else left
        left //= radix
        for k in range(left):
            for r in range(radix):
                for j in range(done):
                    total_re = 0.0
                    total_im = 0.0
                    for q in range(radix):
                        # One turn of both: the short transform's and that of its place in the long one.
                        turn = (q * r * (n // radix) + k * r * done) % n
                        a, b = re[j + done * (k + left * q)], im[j + done * (k + left * q)]
                        total_re += a * cosine[turn] - b * sine[turn]
                        total_im += a * sine[turn] + b * cosine[turn]
                    next_re[j + done * (radix * k + r)] = total_re
                    next_im[j + done * (radix * k + r)] = total_im
        done *= radix
        re, next_re = next_re, re
        im, next_im = next_im, im
    return re, im
