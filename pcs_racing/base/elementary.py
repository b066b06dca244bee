"""Elementary functions (sine, arctangent, exponential and others) with the same bits on every
processor.

The C library and numpy select their code for these functions by the processor (fused multiply-add,
width of vectors). The versions differ in the last bit, and a race amplifies such a difference. The
functions here use only additions, multiplications, divisions and square roots in a fixed order;
IEEE 754 defines their rounding.

Reductions and coefficients come from fdlibm (sine and cosine) [1]_ and Cephes (other functions)
[2]_. Tests check the errors named below against long double.

References
----------
.. [1] Sun Microsystems, "Freely distributable libm", 1993, ``k_sin.c`` and ``k_cos.c``.
.. [2] S. L. Moshier, "Methods and Programs for Mathematical Functions", 1989, ``atan.c``, ``exp.c``
   and ``tanh.c``.
"""

import numpy as np

from pcs_racing.base.compilation import compiled, kernel

# 1.5 * 2**52: added to a number it leaves the nearest integer in the last bits
_ROUNDER = 6755399441055744.0


@kernel(forceinline=True)
def sine_cosine(angle):
    """Return the sine and cosine of an angle in rad, |angle| < 1000, with an error below 1.5e-16.

    There is no branch and no table, so that loops over many angles use vector instructions.
    """
    # The number of quarter turns, rounded by an addition: a call of ``floor`` could not be
    # vectorised everywhere.
    shifted = angle * 0.6366197723675814 + _ROUNDER
    quarter = shifted - _ROUNDER
    turn = np.float64(shifted).view(np.int64)
    # Half a pi in two parts; the product with the first is exact.
    r = (angle - quarter * 1.5707963267341256) - quarter * 6.077100506506192e-11
    q = r * r
    s = q * (
        2.75573137070700676789e-06
        + q * (-2.50507602534068634195e-08 + q * 1.58969099521155010221e-10)
    )
    s = 8.33333333332248946124e-03 + q * (-1.98412698298579493134e-04 + s)
    s = r + r * q * (-1.66666666666666324348e-01 + q * s)
    c = q * (
        -2.75573143513906633035e-07
        + q * (2.08757232129817482790e-09 - q * 1.13596475577881948265e-11)
    )
    c = -1.38888888888741095749e-03 + q * (2.48015872894767294178e-05 + c)
    c = 1.0 - q * (0.5 - q * (4.16666666666666019037e-02 + q * c))
    # After an odd number of quarter turns sine and cosine change places.
    swapped = turn & 1 != 0
    sine = c if swapped else s
    cosine = s if swapped else c
    # The second bit of the number of quarter turns becomes the sign.
    sine_bits = np.float64(sine).view(np.int64) ^ ((turn & 2) << 62)
    cosine_bits = np.float64(cosine).view(np.int64) ^ (((turn + 1) & 2) << 62)
    return np.int64(sine_bits).view(np.float64), np.int64(cosine_bits).view(np.float64)


@kernel(forceinline=True)
def tangent(angle):
    """Return the tangent of an angle in rad, |angle| < 1000.

    The error is at most 3 ulp, away from zeros and poles beyond the first.
    """
    sine, cosine = sine_cosine(angle)
    return sine / cosine


@kernel
def arctangent(x):
    """Return the angle in [-pi/2, pi/2] with the tangent x, in rad, to 1 ulp."""
    # Large arguments are turned by a quarter or an eighth of a circle, into the range of sufficient
    # accuracy of the fraction below; ``rest`` is the rounding error of that turn.
    a = abs(x)
    begin = 0.0
    rest = 0.0
    if a > 2.414213562373095:
        begin, rest, a = 1.5707963267948966, 6.123233995736766e-17, -1.0 / a
    elif a > 0.66:
        begin, rest, a = 0.7853981633974483, 3.061616997868383e-17, (a - 1.0) / (a + 1.0)
    q = a * a
    above = -8.750608600031904122785e-1 * q - 1.615753718733365076637e1
    above = (
        (above * q - 7.500855792314704667340e1) * q - 1.228866684490136173410e2
    ) * q - 6.485021904942025371773e1
    below = (q + 2.485846490142306297962e1) * q + 1.650270098316988542046e2
    below = (below * q + 4.328810604912902668951e2) * q + 4.853903996359136964868e2
    below = below * q + 1.945506571482613964425e2
    angle = begin + ((a * (q * above / below) + rest) + a)
    return -angle if x < 0.0 else angle


@kernel
def arctangent2(y, x):
    """Return the angle in [-pi, pi] of the direction (x, y), in rad, to 2 ulp; 0 at the origin."""
    if x == 0.0 and y == 0.0:
        return 0.0
    # The quotient of the smaller by the larger: it can't overflow.
    if abs(y) > abs(x):
        quarter = np.pi / 2.0 if y > 0.0 else -np.pi / 2.0
        return quarter - arctangent(x / y)
    angle = arctangent(y / x)
    if x > 0.0:
        return angle
    return angle + np.pi if y >= 0.0 else angle - np.pi


@kernel
def arcsine(x):
    """Return the angle in [-pi/2, pi/2] with the sine x in [-1, 1], in rad, to 3 ulp."""
    return arctangent2(x, np.sqrt((1.0 - x) * (1.0 + x)))


@kernel
def exponential(x):
    """Return e**x to 2 ulp; 0 below -745.2 and infinity above 709.8."""
    if not -746.0 < x < 710.0:
        return x + np.inf if not x <= -746.0 else 0.0
    n = np.floor(x * 1.4426950408889634 + 0.5)
    # The logarithm of 2 in two parts; the product with the first is exact.
    r = (x - n * 6.93145751953125e-1) - n * 1.42860682030941723212e-6
    q = r * r
    p = r * ((1.26177193074810590878e-4 * q + 3.02994407707441961300e-2) * q + 1.0)
    below = (
        (3.00198505138664455042e-6 * q + 2.52448340349684104192e-3) * q + 2.27265548208155028766e-1
    ) * q + 2.0
    # In two steps: the power alone may be out of range although the result is not.
    half = np.int64(n) >> 1
    first = np.int64((half + 1023) << 52).view(np.float64)
    second = np.int64((np.int64(n) - half + 1023) << 52).view(np.float64)
    return (1.0 + 2.0 * (p / (below - p))) * first * second


@kernel
def hyperbolic_tangent(x):
    """Return the hyperbolic tangent, to 2 ulp."""
    a = abs(x)
    # Near 0 the exponentials would cancel; a fraction replaces them there.
    if a >= 0.625:
        a = 1.0 - 2.0 / (exponential(2.0 * a) + 1.0)
        return -a if x < 0.0 else a
    q = x * x
    above = (
        -9.64399179425052238628e-1 * q - 9.92877231001918586564e1
    ) * q - 1.61468768441708447952e3
    below = (
        (q + 1.12811678491632931402e2) * q + 2.23548839060100448583e3
    ) * q + 4.84406305325125486048e3
    return x + x * (q * above / below)


@compiled
def sines_cosines(angles):
    """Return the sines and cosines of many angles, shape (N,), in rad, each within 1000 of 0."""
    sines = np.empty(angles.shape[0])
    cosines = np.empty(angles.shape[0])
    for k in range(angles.shape[0]):
        sines[k], cosines[k] = sine_cosine(angles[k])
    return sines, cosines


@compiled
def headings(vectors):
    """Return the angles in [-pi, pi] of plane vectors, shape (N, 2), in rad."""
    out = np.empty(vectors.shape[0])
    for k in range(vectors.shape[0]):
        out[k] = arctangent2(vectors[k, 1], vectors[k, 0])
    return out


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Return the lengths of plane vectors of moderate size, shape (..., 2)."""
    x, y = vectors[..., 0], vectors[..., 1]
    return np.asarray(np.sqrt(x * x + y * y), np.float64)
